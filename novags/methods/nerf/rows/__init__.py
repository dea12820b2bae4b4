"""One file a method with a field: its configuration, and its row of `METHODS`."""
