"""Tone curves: every pixel by itself, one curve a picture. One file a curve."""
