"""Hard cases of what methods are made of, and whole fits."""
