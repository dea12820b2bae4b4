"""Studies whose store is at a URL: its entries, and how nodes without a common folder work with it."""
