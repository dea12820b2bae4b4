"""Scores: pure functions of arrays that compare the results of a method with the truth.

`images` compares encoded pictures, `tone` aligns them first, `linear` compares light, `geometry` depth, `consistency`
one view with another, `noise` the rest of it; `perceptual` is LPIPS.
"""
