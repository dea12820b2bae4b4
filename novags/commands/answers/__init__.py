"""What `list`, `help` and `doctor` answer."""
