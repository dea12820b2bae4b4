"""A multiview set in memory and on disk."""
