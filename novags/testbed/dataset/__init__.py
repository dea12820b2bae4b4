"""Synthetic data sets: a study without methods, published as sets and captures with their whole truth."""
