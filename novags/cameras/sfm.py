"""Structure from motion by COLMAP (pycolmap): SIFT features, exhaustive matching, mapping with known lenses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.colmap import Progress, detect, extraction, verification
from novags.cameras.estimate import CameraEstimate
from novags.cameras.mapping import (
    FEATURES,
    Mapper,
    Mapping,
    Scene,
    check_mapper,
    check_mapping,
    from_reconstruction,
    reconstruct,
)
from novags.cameras.pictures import Pictures, check_kind, check_views
from novags.numbers import check_range

ADVICE = "the other mapper, a lower peak_threshold, larger pictures, more light, or --cameras known"


@dataclass(frozen=True, kw_only=True)
class SfmConfig:
    """What is matched and how reliable a match must be.

    Chosen on 20 dark pictures of tabletop, 160 x 160. At 5 electrons these settings register all 20 raw ones, 4 with
    COLMAP's peak threshold and 11 with its 15 matches. At 20 electrons first_octave=0 registers 5.
    """

    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    mapper: Mapper = "incremental"  # grow from one pair, or solve for all cameras at once (GLOMAP)
    max_features: int = 8192  # a picture, the largest ones
    peak_threshold: float = 0.0033  # contrast of a feature; COLMAP's 0.0067 is for large, clean photographs
    first_octave: int = -1  # -1 doubles the picture first, so that features of 1 px count
    min_matches: int = 10  # geometrically consistent ones that a pair needs in order to count
    max_error: float = 2.0  # px, from the epipolar line; COLMAP's 4 are for pictures of several megapixels
    threads: int = 1  # more are faster, but the order of their work changes the result

    def __post_init__(self) -> None:
        check_kind("sfm", self.pictures)
        check_mapping("sfm", self.mapper, self.min_matches, self.max_error, self.threads)
        if self.max_features < 8:
            raise ValueError(f"sfm needs max_features >= 8, the fewest matches of a pair; got {self.max_features}")
        check_range("max_features of sfm", self.max_features, 8, FEATURES)
        if not self.peak_threshold > 0:
            raise ValueError(f"peak_threshold of sfm must be > 0, got {self.peak_threshold}")
        if self.first_octave not in (-1, 0, 1, 2):
            raise ValueError(f"first_octave of sfm must be -1..2, got {self.first_octave}")


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

    def match(scene: Scene, step: Callable[[str], None]) -> None:
        _match_sift(scene, config, seed, step)

    mapping = Mapping(mapper=config.mapper, min_matches=config.min_matches, threads=config.threads, seed=seed)
    model = reconstruct(pictures, exact, match, len(pictures) + 1, mapping, progress)
    return from_reconstruction(
        model, colors_from, n_points, seed, what="sfm: structure from motion", kind=config.pictures, advice=ADVICE
    )


def _match_sift(scene: Scene, config: SfmConfig, seed: int, step: Callable[[str], None]) -> None:
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
