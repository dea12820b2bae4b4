"""What there is to choose from, and pages about terms."""
