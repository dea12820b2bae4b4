"""One file an enhancer: its configuration, its row of `ENHANCERS`, and the method that fits to its pictures."""
