"""Structure from motion by COLMAP (pycolmap): SIFT features, exhaustive matching, mapping with known lenses."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import CameraEstimate
from novags.cameras.motion.colmap import detect, extraction, verification
from novags.cameras.motion.mapping import Mapping, PictureDatabase, check_mapper, from_reconstruction, reconstruct
from novags.cameras.pictures import check_views
from novags.cameras.source import Progress
from novags.cameras.sources.sfm import SfmConfig

ADVICE = "the other mapper, a lower peak_threshold, larger pictures, more light, or --cameras known"


def check_installed(config: SfmConfig) -> None:
    """Raise a ValueError that says what to do if this pycolmap lacks the mapper."""
    check_mapper(config.mapper)


def structure_from_motion(
    pictures: NDArray[np.uint8],
    Ks: NDArray[np.floating[Any]],
    colors_from: Tensor,
    *,
    n_points: int,
    config: SfmConfig | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> CameraEstimate:
    """Cameras and points of the largest reconstruction that the pictures give.

    Args:
        pictures: [C, h, w, 3] uint8, in which features are detected.
        Ks: [C, 3, 3], pixels, centres at +0.5; taken as exact.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: How many points. Where the reconstruction has fewer, random pixels with depths interpolated between
            observed points of their view are added.
        config: None takes the defaults.
        seed: Of RANSAC and of the choice of points.
        progress: Called with (done, total, what).

    Raises:
        ValueError: For wrong shapes or types, a mapper that pycolmap lacks, or if fewer than 2 views register.
    """
    config = config or SfmConfig()
    pictures, exact = np.asarray(pictures), np.asarray(Ks, np.float64)
    check_views(pictures, colors_from, n_points, exact)
    check_installed(config)

    def match(scene: PictureDatabase, step: Callable[[str], None]) -> None:
        _match_sift(scene, config, seed, step)

    mapping = Mapping(mapper=config.mapper, min_matches=config.min_matches, threads=config.threads, seed=seed)
    model = reconstruct(pictures, exact, match, len(pictures) + 1, mapping, progress)
    return from_reconstruction(
        model, colors_from, n_points, seed, what="sfm: structure from motion", kind=config.pictures, advice=ADVICE
    )


def _match_sift(scene: PictureDatabase, config: SfmConfig, seed: int, step: Callable[[str], None]) -> None:
    import pycolmap

    features = extraction(
        pycolmap, max_features=config.max_features, peak_threshold=config.peak_threshold,
        first_octave=config.first_octave, threads=config.threads,
    )  # fmt: skip
    extractor = pycolmap.FeatureExtractor.create(features, pycolmap.Device.cpu)
    with pycolmap.Database.open(scene.database) as found:
        for name in scene.names:
            step("features")
            detect(pycolmap, found, name, scene.root, extractor)
    step("matches")
    pycolmap.match_exhaustive(
        scene.database,
        pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=config.threads),
        verification_options=verification(
            pycolmap, min_matches=config.min_matches, max_error=config.max_error, seed=seed
        ),
        device=pycolmap.Device.cpu,
    )
