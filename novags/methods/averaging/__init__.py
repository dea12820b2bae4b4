"""The limit of counting statistics across views: exposures brought together by the true surface, and averaged."""
