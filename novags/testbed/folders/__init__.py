"""Results on disk: sets, captures, runs, and the files in them."""
