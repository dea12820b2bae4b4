"""Compare: two checkouts, or two methods, on the same captures, paired by scene, seed and view."""
