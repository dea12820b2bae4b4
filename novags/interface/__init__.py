"""The test bed in Python: finished folders as arrays and data frames, and commands that run in the background."""
