"""COLMAP (pycolmap) as both uses of it need it: quiet, on the CPU, and reproducible with one thread and a seed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

LOWER_EDGE = 1.5  # scales
SEEDS = 2**31  # number of seeds that COLMAP accepts


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


def detect(pycolmap: Any, database: Any, name: str, folder: Path, extractor: Any) -> int:
    """Write the features of a picture, which the open database knows, and return the number of its camera.

    VLFeat leaves the descriptors of features in the last row of their octave as the memory was, which varies from run
    to run. A pixel of the octave is at most 1 / 1.8 of the scale, so those nearer to the lower edge than that are
    dropped, with room for two halvings that did not come out even.
    """
    points, descriptors = extractor.extract(bitmap := pycolmap.Bitmap.read(folder / name, False))
    shapes = np.array([(p.x, p.y, p.a11, p.a12, p.a21, p.a22) for p in points], np.float32).reshape(-1, 6)
    scales = np.array([p.compute_scale() for p in points])
    kept = shapes[:, 1] < bitmap.height - LOWER_EDGE * scales
    image = database.read_image_with_name(name)
    database.write_keypoints(image.image_id, shapes[kept])
    whole = pycolmap.FeatureDescriptors(descriptors.type, np.ascontiguousarray(descriptors.data[kept]))
    database.write_descriptors(image.image_id, whole)
    return int(image.camera_id)


def verification(pycolmap: Any, *, min_matches: int, max_error: float, seed: int) -> Any:
    """Options of the geometry of a pair: its consistent matches, and their distance from the epipolar line, px."""
    options = pycolmap.TwoViewGeometryOptions(min_num_inliers=min_matches)
    options.ransac.random_seed, options.ransac.max_error = seed % SEEDS, max_error
    return options


def global_mapping(pycolmap: Any, *, threads: int, seed: int, min_matches: int, fewest: int) -> Any:
    """Options of the mapper that solves for all cameras at once: matches of a pair, and views of a model, at least."""
    options = pycolmap.GlobalPipelineOptions(
        num_threads=threads, random_seed=seed % SEEDS, min_num_matches=min_matches, min_model_size=fewest
    )
    options.mapper.bundle_adjustment.ceres.use_gpu = options.mapper.global_positioning.use_gpu = False
    return options


def largest(models: dict[int, Any]) -> Any:
    """The reconstruction with the most views, and among equals the most points; None without any."""
    return max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)
