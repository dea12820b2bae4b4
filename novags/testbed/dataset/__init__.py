"""Synthetic data sets: a study without methods, published as sets and captures with all that is known about them."""
