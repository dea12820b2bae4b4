"""Simulated scenes: a Mitsuba scene in, a ground-truth multiview set out."""
