"""The training loop of a field."""
