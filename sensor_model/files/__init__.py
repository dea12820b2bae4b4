"""Camera files and raw files."""
