"""Enhancing networks: one file a network, its row in `rows`. `kind` is what all have in common."""
