"""What the paper compares against, one file a method."""
