"""Print, with the type that it is set in."""
