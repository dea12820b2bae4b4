"""Files of weights of enhancing networks."""
