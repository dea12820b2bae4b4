"""Studies whose store is at a URL: what is there, and how nodes without a common folder work with it."""
