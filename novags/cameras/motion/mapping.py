"""Cameras and points from matched features, by COLMAP (pycolmap): incremental or global mapping with known lenses.

The caller chooses the features: SIFT (`sfm`) or a network's (`hloc`). Intrinsics stay as given. Everything runs on the
CPU and, with one thread, reproducibly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate, as_estimate
from novags.cameras.motion.colmap import SEEDS, global_mapping, largest, quiet
from novags.cameras.pictures import place_of, write_pictures
from novags.cameras.points import averaged, fill, seen_colors
from novags.cameras.settings import Mapper, Pictures
from novags.cameras.source import Progress
from sensor_model.files.scratch import scratch


@dataclass(frozen=True)
class PictureDatabase:
    """The input of matching: pictures in a folder, known to an empty database.

    Attributes:
        root: The folder, for files of the caller's too.
        database: The file of the database.
        names: Of the pictures in the folder, in order.
    """

    root: Path
    database: Path
    names: list[str]


Match = Callable[[PictureDatabase, Callable[[str], None]], None]
"""Writes features and geometrically verified matches into the database; calls the second argument at each step."""


@dataclass(frozen=True, kw_only=True)
class Mapping:
    """How cameras are found from matches."""

    mapper: Mapper
    min_matches: int  # of a pair
    threads: int
    seed: int


def check_mapper(mapper: str) -> None:
    """Raise a ValueError that says what to do if this pycolmap lacks the mapper."""
    import pycolmap

    if mapper == "global" and not hasattr(pycolmap, "global_mapping"):
        raise ValueError(f"pycolmap {pycolmap.__version__} has no global mapper: pip install 'pycolmap>=4'")


def reconstruct(
    pictures: NDArray[np.uint8], Ks: Array, match: Match, steps: int, mapping: Mapping, progress: Progress | None
) -> Any:
    """The pycolmap reconstruction with the most views, and among equals the most points; None without any.

    Args:
        pictures: [C, h, w, 3] uint8.
        Ks: [C, 3, 3], pixels, centres at +0.5; taken as exact.
        match: Finds the matches.
        steps: How many it reports.
        mapping: How cameras are found from them.
        progress: Called with (done, total, what).
    """
    import pycolmap

    total = steps + len(pictures)
    done = iter(range(total))

    def step(what: str) -> None:
        if progress:
            progress(next(done, total - 1), total, what)

    with quiet(pycolmap), scratch("sfm") as root:
        scene = PictureDatabase(root, root / "database.db", write_pictures(root, pictures))
        pycolmap.set_random_seed(mapping.seed % SEEDS)
        pycolmap.Database.open(scene.database).close()  # makes the file
        for name, K in zip(scene.names, Ks, strict=True):
            # One call per picture, in order: picture and camera numbers then depend on nothing else.
            pycolmap.import_images(scene.database, root, pycolmap.CameraMode.PER_IMAGE, [name], _lens(pycolmap, K))
        match(scene, step)
        step("cameras")
        if mapping.mapper == "global":
            models = pycolmap.global_mapping(scene.database, root, root, _global(pycolmap, mapping))
        else:
            models = pycolmap.incremental_mapping(
                scene.database, root, root, _incremental(pycolmap, mapping),
                next_image_callback=lambda: step("cameras"),
            )  # fmt: skip
    if progress:
        progress(total, total, "cameras")
    return largest(models)


def _lens(pycolmap: Any, K: Array) -> Any:
    parameters = ",".join(repr(float(K[i, j])) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return pycolmap.ImageReaderOptions(camera_model="PINHOLE", camera_params=parameters)


def _incremental(pycolmap: Any, mapping: Mapping) -> Any:
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=mapping.threads, random_seed=mapping.seed % SEEDS, min_num_matches=mapping.min_matches,
        min_model_size=2, extract_colors=False, ba_refine_focal_length=False, ba_refine_extra_params=False,
    )  # fmt: skip
    mapper = options.mapper
    mapper.abs_pose_refine_focal_length = mapper.abs_pose_refine_extra_params = False
    # Small dark pictures have fewer matches than COLMAP's 100 for the first pair and 30 for each further view.
    mapper.init_min_num_inliers, mapper.abs_pose_min_num_inliers = 2 * mapping.min_matches, mapping.min_matches
    return options


def _global(pycolmap: Any, mapping: Mapping) -> Any:
    options = global_mapping(
        pycolmap, threads=mapping.threads, seed=mapping.seed, min_matches=mapping.min_matches, fewest=2
    )
    adjustment = options.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = False
    return options


def from_reconstruction(
    model: Any, colors_from: Tensor, n_points: int, seed: int, *, what: str, kind: str, advice: str
) -> CameraEstimate:
    """Cameras and points of a pycolmap reconstruction of pictures that `write_pictures` wrote.

    Views without a pose are left out. Where the reconstruction has fewer points, random pixels with depths interpolated
    between observed points of their view are added.

    Args:
        model: The reconstruction, or None.
        colors_from: [C, h, w, 3] dark images of all views, 0..1.
        n_points: How many points.
        seed: Of the choice of points.
        what: Made the reconstruction, for messages.
        kind: Of pictures, for messages.
        advice: A remedy where too few views have a pose, beside other pictures.

    Raises:
        ValueError: If fewer than 2 views have a pose, or if a lens is not a pinhole.
    """
    images = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name) if model else []
    if len(images) < 2:
        raise ValueError(
            f"{what} registered {len(images)} of {len(colors_from)} views of the {kind} pictures, at least 2 are "
            f"needed: try {' or '.join(f'pictures={other}' for other in get_args(Pictures) if other != kind)}, {advice}"
        )
    registered = tuple(place_of(image.name) for image in images)
    viewmats = np.stack([np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in images])
    if lenses := {i.camera.model.name for i in images} - {"PINHOLE", "SIMPLE_PINHOLE"}:
        raise ValueError(f"{what}: lenses must be pinholes, got {', '.join(sorted(lenses))}")
    Ks = np.stack([image.camera.calibration_matrix() for image in images])
    dark = colors_from.detach().cpu().numpy().astype(np.float32)[list(registered)]
    observed = [[p.point3D_id for p in image.points2D if p.has_point3D()] for image in images]
    points, colors = _points(model, observed, dark, viewmats, Ks, n_points, np.random.default_rng(seed))
    matched = min(len(points), model.num_points3D())
    made_of = {"of the sparse model": matched, "between its points": len(points) - matched}
    colors, size = averaged(points, colors), (dark.shape[2], dark.shape[1])
    return as_estimate(registered, viewmats, Ks, points, colors, size=size, made_of=made_of)


def _points(
    model: Any, observed: list[list[int]], dark: NDArray[np.float32], viewmats: Array, Ks: Array, count: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """`count` points and their colours: the model's points, the rest interpolated between them."""
    ids = sorted(model.points3D)
    xyz = np.array([model.points3D[i].xyz for i in ids]).reshape(-1, 3)
    if len(ids) > count:
        xyz = xyz[rng.choice(len(ids), count, replace=False)]
        return xyz, seen_colors(xyz, dark, viewmats, Ks)
    row = {point: i for i, point in enumerate(ids)}
    of_view = [xyz[[row[i] for i in seen]].reshape(-1, 3) for seen in observed]
    more, colors = fill(of_view, dark, viewmats, Ks, count - len(xyz), rng)
    return np.concatenate([xyz, more]), np.concatenate([seen_colors(xyz, dark, viewmats, Ks), colors])
