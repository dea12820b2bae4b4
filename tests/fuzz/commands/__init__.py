"""Whole commands on a small project of which one or two things are not as they should be."""
