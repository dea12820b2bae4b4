"""COLMAP (pycolmap) as both uses of it need it: quiet, on the CPU, and reproducible with one thread and a seed."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Progress = Callable[[int, int, str], None]
"""Steps done, total steps, and the current activity."""


@contextmanager
def quiet(pycolmap: Any) -> Iterator[None]:
    """COLMAP without its log lines, some of which are warnings about pairs without matches."""
    before, pycolmap.logging.minloglevel = pycolmap.logging.minloglevel, int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def extraction(pycolmap: Any, *, max_features: int, peak_threshold: float, first_octave: int, threads: int) -> Any:
    """Options of SIFT: so many features a picture, the largest ones; contrast 0..1; -1 doubles the picture first."""
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=threads)
    options.sift.max_num_features = max_features
    options.sift.peak_threshold = peak_threshold
    options.sift.first_octave = first_octave
    return options


def verification(pycolmap: Any, *, min_matches: int, max_error: float, seed: int) -> Any:
    """Options of the geometry of a pair: its consistent matches, and their distance from the epipolar line, px."""
    options = pycolmap.TwoViewGeometryOptions(min_num_inliers=min_matches)
    options.ransac.random_seed, options.ransac.max_error = seed, max_error
    return options


def largest(models: dict[int, Any]) -> Any:
    """The reconstruction with the most views, and among equals the most points; None without any."""
    return max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)
