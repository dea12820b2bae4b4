"""Rows of `VARIANTS` of methods that have no folder of their own, or a single variant."""
