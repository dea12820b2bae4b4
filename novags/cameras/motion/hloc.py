"""Structure from motion with features and matches of networks, by the user's own installation of hloc.

hloc (github.com/cvg/Hierarchical-Localization, Apache-2) finds features and matches. They are mapped here, as for
`sfm`: its own mapping call takes one lens for all pictures, and here each view has its own, which stays fixed.

Parts of the package in use (version 1.5): `extract_features.main` and `.confs`, `match_features.main` and `.confs`,
`pairs_from_exhaustive.main`, and `utils.io.get_keypoints` and `.get_matches`. Its keypoints have the centre of the
first pixel at 0, COLMAP's at 0.5.
"""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import CameraEstimate
from novags.cameras.motion.colmap import verification
from novags.cameras.motion.mapping import Mapping, PictureDatabase, check_mapper, from_reconstruction, reconstruct
from novags.cameras.pictures import check_views
from novags.cameras.source import Progress
from novags.cameras.sources.hloc import HlocConfig
from sensor_model.files.door import read_text

ADVICE = (
    "other features (features=superpoint_max enlarges small pictures), the other mapper, more light, or --cameras known"
)


def check_installed(config: HlocConfig) -> None:
    """Raise a ValueError that says what to do if the package is missing or does not know these features."""
    if importlib.util.find_spec("hloc") is None:
        raise ValueError(
            "cameras hloc need the package hloc, which is not installed: clone "
            "https://github.com/cvg/Hierarchical-Localization with --recursive and pip install it into this "
            "environment (Apache-2; it fetches weights at their first use, and the weights of SuperPoint and "
            "SuperGlue are for non-commercial research)"
        )
    check_mapper(config.mapper)
    _confs(config)


def hloc_cameras(
    pictures: NDArray[np.uint8],
    Ks: NDArray[np.floating[Any]],
    colors_from: Tensor,
    *,
    n_points: int,
    config: HlocConfig | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> CameraEstimate:
    """Cameras and points of the largest reconstruction that the pictures give.

    Args:
        pictures: [C, h, w, 3] uint8, in which features are detected.
        Ks: [C, 3, 3], pixels, centres at +0.5; taken as exact.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: How many points, as in `sfm`.
        config: None takes the defaults.
        seed: Of RANSAC, of the choice of points, and of a network that draws random numbers.
        progress: Called with (done, total, what).

    Raises:
        ValueError: For wrong shapes or types, if the package is missing or does not know the features, if its files
            are not as expected, or if fewer than 2 views register.
    """
    config = config or HlocConfig()
    pictures, exact = np.asarray(pictures), np.asarray(Ks, np.float64)
    check_views(pictures, colors_from, n_points, exact)
    check_installed(config)

    def match(scene: PictureDatabase, step: Callable[[str], None]) -> None:
        _match_learned(scene, config, seed, step)

    mapping = Mapping(mapper=config.mapper, min_matches=config.min_matches, threads=config.threads, seed=seed)
    model = reconstruct(pictures, exact, match, 3, mapping, progress)
    what = f"hloc: structure from motion with {config.features}"
    return from_reconstruction(model, colors_from, n_points, seed, what=what, kind=config.pictures, advice=ADVICE)


def _part(name: str) -> Any:
    try:
        return importlib.import_module(f"hloc.{name}")
    except ImportError as error:
        raise ValueError(
            f"hloc is installed, but hloc.{name} cannot be imported ({error}): install the package it asks for"
        ) from error


def _confs(config: HlocConfig) -> tuple[dict[str, Any], dict[str, Any]]:
    """The configurations of the features and of the matcher."""
    features, matchers = _part("extract_features").confs, _part("match_features").confs
    if config.features not in features:
        raise ValueError(f"features of hloc must be one of {', '.join(sorted(features))}, got {config.features!r}")
    found, matcher = features[config.features], config.matcher
    if matcher == "auto":
        glue = f"{found['model']['name']}+lightglue"
        matcher = glue if glue in matchers else "NN-ratio"
    if matcher not in matchers:
        raise ValueError(f"matcher of hloc must be auto or one of {', '.join(sorted(matchers))}, got {matcher!r}")
    return found, matchers[matcher]


def _match_learned(scene: PictureDatabase, config: HlocConfig, seed: int, step: Callable[[str], None]) -> None:
    """Features and matches of hloc in the database; matches are verified there as `sfm` verifies its own."""
    import pycolmap

    features, matcher = _confs(config)
    files = _part("utils.io")
    pairs, found, matched = (scene.root / name for name in ("pairs.txt", "features.h5", "matches.h5"))
    step("features")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        # Half precision, its default, rounds positions to a quarter of a pixel in pictures of 512 px and more.
        _part("extract_features").main(
            features, scene.root, image_list=scene.names, feature_path=found, as_half=False
        )  # fmt: skip
        step("matches")
        _part("pairs_from_exhaustive").main(pairs, image_list=scene.names)
        _part("match_features").main(matcher, pairs, found, matches=matched)
    with pycolmap.Database.open(scene.database) as database:
        ids = {name: database.read_image_with_name(name).image_id for name in scene.names}
        counts = {}
        for name in scene.names:
            keypoints = np.asarray(files.get_keypoints(found, name), np.float32) + 0.5
            if keypoints.ndim != 2 or keypoints.shape[1] != 2:
                raise ValueError(f"hloc's keypoints must be [n, 2], got {list(keypoints.shape)}: use hloc 1.5")
            database.write_keypoints(ids[name], keypoints)
            counts[name] = len(keypoints)
        for first, second in (line.split() for line in read_text(pairs).splitlines()):
            rows = np.asarray(files.get_matches(matched, first, second)[0]).reshape(-1, 2)
            if len(rows) and (rows.min() < 0 or (rows.max(0) >= [counts[first], counts[second]]).any()):
                raise ValueError(f"hloc's matches of {first} and {second} name features that are not there")
            database.write_matches(ids[first], ids[second], rows.astype(np.uint32))
    step("verified matches")
    options = verification(pycolmap, min_matches=config.min_matches, max_error=config.max_error, seed=seed)
    pycolmap.verify_matches(scene.database, pairs, options=options)
