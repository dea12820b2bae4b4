"""Curves as tables, figures and a page."""
