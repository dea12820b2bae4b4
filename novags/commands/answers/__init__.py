"""The answers of `list`, `help` and `doctor`."""
