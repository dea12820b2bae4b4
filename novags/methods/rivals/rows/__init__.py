"""One file a method: its configuration, and its row of `METHODS`."""
