"""Structure from motion by COLMAP (pycolmap): SIFT features, exhaustive matching, incremental or global mapping.

Intrinsics are known and stay fixed. Everything runs on the CPU and, with one thread, reproducibly.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.colmap import Progress, detect, extraction, largest, quiet, verification
from novags.cameras.estimate import Array, CameraEstimate, as_estimate
from novags.cameras.points import averaged, fill, seen_colors
from sensor_model.files.scratch import scratch

Pictures = Literal["raw", "enhanced", "denoised"]
Mapper = Literal["incremental", "global"]


@dataclass(frozen=True, kw_only=True)
class SfmConfig:
    """What is matched and how reliable a match must be.

    Chosen on 20 dark pictures of tabletop, 160 x 160. At 5 electrons this registers all 20 raw ones; with
    COLMAP's peak threshold it is 4, with its 15 matches 11. With first_octave=0 it is 5 at 20 electrons.
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
        for name, value, known in (("pictures", self.pictures, Pictures), ("mapper", self.mapper, Mapper)):
            if value not in get_args(known):
                raise ValueError(f"{name} of sfm must be one of {', '.join(get_args(known))}, got {value!r}")
        if self.max_features < 8 or self.min_matches < 8:
            raise ValueError(
                "sfm needs max_features and min_matches >= 8, because fewer matches do not fix a pair of cameras; "
                f"got {self.max_features} and {self.min_matches}"
            )
        if not (self.peak_threshold > 0 and self.max_error > 0):
            raise ValueError(f"peak_threshold and max_error must be > 0, got {self.peak_threshold}, {self.max_error}")
        if self.first_octave not in (-1, 0, 1, 2) or self.threads < 1:
            raise ValueError(f"first_octave must be -1..2 and threads >= 1, got {self.first_octave}, {self.threads}")


def check_installed(config: SfmConfig) -> None:
    """Raise a ValueError that says what to do if this pycolmap lacks the mapper."""
    import pycolmap

    if config.mapper == "global" and not hasattr(pycolmap, "global_mapping"):
        raise ValueError(
            f"pycolmap {pycolmap.__version__} has no global mapper: install pycolmap >= 4, or use mapper=incremental"
        )


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
    pictures, Ks = np.asarray(pictures), np.asarray(Ks, np.float64)
    _check(pictures, Ks, colors_from, n_points)
    check_installed(config)
    model = _reconstruct(pictures, Ks, config, seed, progress or (lambda done, total, what: None))
    images = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name) if model else []
    if len(images) < 2:
        raise ValueError(
            f"sfm: structure from motion registered {len(images)} of {len(pictures)} views of the {config.pictures} "
            "pictures, at least 2 are needed: try pictures=enhanced or pictures=denoised, the other mapper, a lower "
            "peak_threshold, larger pictures, more light, or --cameras known"
        )
    registered = tuple(int(Path(image.name).stem) for image in images)
    viewmats = np.stack([np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in images])
    dark = colors_from.detach().cpu().numpy().astype(np.float32)[list(registered)]
    placed_Ks = np.stack([image.camera.calibration_matrix() for image in images])  # as given
    observed = [[p.point3D_id for p in image.points2D if p.has_point3D()] for image in images]
    rng = np.random.default_rng(seed)
    points, colors = _points(model, observed, dark, viewmats, placed_Ks, n_points, rng)
    matched = min(len(points), model.num_points3D())
    made_of = {"of the sparse model": matched, "between its points": len(points) - matched}
    return as_estimate(registered, viewmats, placed_Ks, points, averaged(points, colors), made_of=made_of)


def _check(pictures: np.ndarray, Ks: np.ndarray, colors_from: Tensor, n_points: int) -> None:
    if pictures.ndim != 4 or pictures.shape[-1] != 3 or pictures.dtype != np.uint8 or len(pictures) < 2:
        raise ValueError(f"pictures must be uint8 [C >= 2, h, w, 3], got {pictures.dtype} {pictures.shape}")
    if Ks.shape != (len(pictures), 3, 3) or tuple(colors_from.shape) != pictures.shape:
        raise ValueError(
            f"Ks must be [C, 3, 3] and colors_from [C, h, w, 3] like the {len(pictures)} pictures {pictures.shape}, "
            f"got {Ks.shape} and {tuple(colors_from.shape)}"
        )
    if n_points < 2:
        raise ValueError(f"n_points must be >= 2, got {n_points}")


def _reconstruct(pictures: np.ndarray, Ks: np.ndarray, config: SfmConfig, seed: int, progress: Progress) -> Any:
    """The pycolmap reconstruction with the most views, and among equals the most points; None without any."""
    import cv2
    import pycolmap

    count = len(pictures)
    total = 2 * count + 1
    features = extraction(
        pycolmap, max_features=config.max_features, peak_threshold=config.peak_threshold,
        first_octave=config.first_octave, threads=config.threads,
    )  # fmt: skip
    pairs = verification(pycolmap, min_matches=config.min_matches, max_error=config.max_error, seed=seed)
    with quiet(pycolmap), scratch("sfm") as root:
        database = root / "database.db"
        pycolmap.set_random_seed(seed)
        extractor = pycolmap.FeatureExtractor.create(features, pycolmap.Device.cpu)
        pycolmap.Database.open(database).close()  # makes the file
        for i, (picture, K) in enumerate(zip(pictures, Ks, strict=True)):
            progress(i, total, "features")
            name = f"{i:06d}.png"
            if not cv2.imwrite(str(root / name), picture[..., ::-1]):
                raise ValueError(f"sfm: cannot write a temporary picture into {root}: free some space there")
            # One call per picture, in order: picture and camera numbers then depend on nothing else.
            pycolmap.import_images(database, root, pycolmap.CameraMode.PER_IMAGE, [name], _camera(pycolmap, K))
            with pycolmap.Database.open(database) as found:
                detect(pycolmap, found, name, root, extractor)
        progress(count, total, "matches")
        pycolmap.match_exhaustive(
            database,
            pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=config.threads),
            verification_options=pairs,
            device=pycolmap.Device.cpu,
        )
        progress(count + 1, total, "cameras")
        if config.mapper == "global":
            models = pycolmap.global_mapping(database, root, root, _global(pycolmap, config, seed))
        else:
            placed = iter(range(count + 2, total))
            models = pycolmap.incremental_mapping(
                database, root, root, _incremental(pycolmap, config, seed),
                next_image_callback=lambda: progress(next(placed, total - 1), total, "cameras"),
            )  # fmt: skip
        progress(total, total, "cameras")
    return largest(models)


def _camera(pycolmap: Any, K: np.ndarray) -> Any:
    parameters = ",".join(repr(float(K[i, j])) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return pycolmap.ImageReaderOptions(camera_model="PINHOLE", camera_params=parameters)


def _incremental(pycolmap: Any, config: SfmConfig, seed: int) -> Any:
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=config.threads, random_seed=seed, min_num_matches=config.min_matches, min_model_size=2,
        extract_colors=False, ba_refine_focal_length=False, ba_refine_extra_params=False,
    )  # fmt: skip
    mapper = options.mapper
    mapper.abs_pose_refine_focal_length = mapper.abs_pose_refine_extra_params = False
    # Small dark pictures have fewer matches than COLMAP's 100 for the first pair and 30 for each further view.
    mapper.init_min_num_inliers, mapper.abs_pose_min_num_inliers = 2 * config.min_matches, config.min_matches
    return options


def _global(pycolmap: Any, config: SfmConfig, seed: int) -> Any:
    options = pycolmap.GlobalPipelineOptions(
        num_threads=config.threads, random_seed=seed, min_num_matches=config.min_matches, min_model_size=2
    )
    adjustment = options.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = False
    adjustment.ceres.use_gpu = options.mapper.global_positioning.use_gpu = False
    return options


def _points(
    model: Any, observed: list[list[int]], dark: np.ndarray, viewmats: Array, Ks: Array, count: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """`count` points and their colours: those of the model, the rest interpolated between them."""
    ids = sorted(model.points3D)
    xyz = np.array([model.points3D[i].xyz for i in ids]).reshape(-1, 3)
    if len(ids) > count:
        xyz = xyz[rng.choice(len(ids), count, replace=False)]
        return xyz, seen_colors(xyz, dark, viewmats, Ks)
    row = {point: i for i, point in enumerate(ids)}
    of_view = [xyz[[row[i] for i in seen]].reshape(-1, 3) for seen in observed]
    more, colors = fill(of_view, dark, viewmats, Ks, count - len(xyz), rng)
    return np.concatenate([xyz, more]), np.concatenate([seen_colors(xyz, dark, viewmats, Ks), colors])
