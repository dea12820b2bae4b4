"""One file a network: its configuration, its row of `ENHANCERS`, and the method that fits to its pictures."""
