"""What counting statistics across views can give: exposures brought together by the true surface, and averaged."""
