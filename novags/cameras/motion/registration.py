"""Unknown cameras of photographs, by COLMAP (pycolmap): features, matches, mapping with the lens.

`sfm` places dark pictures whose lens is known. Here lens, distortion included, and poses are found together. Everything
runs on the CPU with one thread, and is the same for the same seed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from novags.cameras.estimate import Array
from novags.cameras.motion.colmap import SEEDS, detect, extraction, global_mapping, largest, quiet, verification
from novags.cameras.settings import Mapper
from novags.cameras.source import Progress
from simscenes.sets.readers.colmap import colmap_lens
from simscenes.sets.readers.photographs import DistortedPinhole

ALL_PAIRS = 100  # frames of a video; of more, not every pair is matched
NEAR = 10  # frames of a video that are matched with each other; farther ones at distances of 2^k
MANY = 10  # pictures of one lens that fix its eight parameters; fewer fix one of distortion
MIN_MATCHES = 15  # geometrically consistent ones that a pair needs in order to count
MAX_ERROR = 4.0  # px, from the epipolar line
PLACED = 3  # pictures that make a set: one is held out, two are trained on


@dataclass(frozen=True)
class Shot:
    """A picture to place.

    Attributes:
        name: Of its file, which lies in the folder that `register` is given.
        camera: Pictures with the same number share a lens.
        focal: In px, where it is known.
    """

    name: str
    camera: int
    focal: float | None


@dataclass(frozen=True)
class Observed:
    """Observations of one view.

    Attributes:
        points: Which points it sees [n].
        pixels: Where, as the picture is [n, 2].
        rays: x / z and y / z of them in its camera [n, 2]: without the lens.
    """

    points: NDArray[np.intp]
    pixels: Array
    rays: Array


@dataclass(frozen=True)
class Registered:
    """Where pictures were taken, and the points they share, in a frame of their own.

    Attributes:
        indices: Which of the shots; increasing.
        viewmats: [R, 4, 4], world to camera.
        lenses: One for each of them.
        points: [P, 3].
        seen: The observations of each view.
        error: Mean reprojection error, px.
    """

    indices: tuple[int, ...]
    viewmats: Array
    lenses: tuple[DistortedPinhole, ...]
    points: Array
    seen: tuple[Observed, ...]
    error: float


def register(
    folder: Path, shots: Sequence[Shot], *, max_features: int, peak_threshold: float, mapper: Mapper, in_order: bool,
    seed: int, progress: Progress,
) -> Registered | None:  # fmt: skip
    """Place as many pictures as one reconstruction can hold.

    Args:
        folder: Of the pictures; a database is written there.
        shots: The pictures.
        max_features: A picture.
        peak_threshold: Contrast of a feature, 0..1.
        mapper: Grows from one pair, or solves for all cameras at once.
        in_order: Whether they are frames of a video: then those far apart need not be matched.
        seed: Of RANSAC and mapping.
        progress: Called with (done, total, what).

    Returns:
        None if fewer than `PLACED` find a place.
    """
    import pycolmap

    total, database = 3 * len(shots), folder / "database.db"
    with quiet(pycolmap):
        pycolmap.set_random_seed(seed % SEEDS)
        options = extraction(
            pycolmap, max_features=max_features, peak_threshold=peak_threshold, first_octave=-1, threads=1
        )
        _detect(pycolmap, database, folder, shots, options, progress)
        _match(pycolmap, database, folder, shots, in_order, seed, progress)
        placed = iter(range(2 * len(shots) + 1, total))
        if mapper == "global":
            how = global_mapping(pycolmap, threads=1, seed=seed, min_matches=MIN_MATCHES, fewest=PLACED)
            models = pycolmap.global_mapping(database, folder, folder, how)
        else:
            models = pycolmap.incremental_mapping(
                database, folder, folder, _incremental(pycolmap, seed),
                next_image_callback=lambda: progress(next(placed, total - 1), total, "poses"),
            )  # fmt: skip
        progress(total, total, "poses")
    model = largest(models)
    if model is None or model.num_reg_images() < PLACED:
        return None
    return _placed(model, [shot.name for shot in shots], folder)


def _detect(
    pycolmap: Any, database: Path, folder: Path, shots: Sequence[Shot], options: Any, progress: Progress
) -> None:
    """Features of every picture, in order; the first picture of each camera brings the camera in."""
    cameras: dict[int, int] = {}
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    pycolmap.Database.open(database).close()  # makes the file
    for done, shot in enumerate(shots):
        progress(done, 3 * len(shots), "features")
        if shot.camera in cameras:
            reader = pycolmap.ImageReaderOptions(existing_camera_id=cameras[shot.camera])
        else:
            alike = [other for other in shots if other.camera == shot.camera]
            reader = pycolmap.ImageReaderOptions(camera_model="OPENCV" if len(alike) >= MANY else "SIMPLE_RADIAL")
            if shot.focal is not None:
                reader.camera_params = _start(folder / shot.name, reader.camera_model, shot.focal)
        pycolmap.import_images(database, folder, pycolmap.CameraMode.SINGLE, [shot.name], reader)
        with pycolmap.Database.open(database) as found:
            cameras[shot.camera] = detect(pycolmap, found, shot.name, folder, extractor)


def _start(file: Path, model: str, focal: float) -> str:
    """Parameters of a lens without distortion; COLMAP refines a stated focal length less eagerly than a guess."""
    from simscenes.sets.pictures.image_file import image_size

    width, height = image_size(file)
    middle = [width / 2, height / 2]
    values = [focal, focal, *middle, 0, 0, 0, 0] if model == "OPENCV" else [focal, *middle, 0]
    return ",".join(repr(float(value)) for value in values)


def pairs_of(count: int, in_order: bool) -> list[list[int]]:
    """For each picture, the later ones that it is matched with."""
    if not in_order or count <= ALL_PAIRS:
        return [list(range(i + 1, count)) for i in range(count)]
    # Every tenth frame is matched with every other tenth one, so that a camera that comes back closes the loop.
    return [
        [j for j in range(i + 1, count) if (gap := j - i) <= NEAR or gap & (gap - 1) == 0 or i % NEAR == j % NEAR == 0]
        for i in range(count)
    ]


def _match(
    pycolmap: Any, database: Path, folder: Path, shots: Sequence[Shot], in_order: bool, seed: int, progress: Progress
) -> None:
    """Matches of all pairs, the pairs of one picture at a time, which gives progress and a fixed order."""
    listed = folder / "pairs.txt"
    for i, others in enumerate(pairs_of(len(shots), in_order)):
        progress(len(shots) + i, 3 * len(shots), "matches")
        if not others:
            continue
        listed.write_text("".join(f"{shots[i].name} {shots[j].name}\n" for j in others), encoding="utf-8")
        pycolmap.match_image_pairs(
            database,
            pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1),
            pycolmap.ImportedPairingOptions(match_list_path=listed),
            verification(pycolmap, min_matches=MIN_MATCHES, max_error=MAX_ERROR, seed=seed),
            device=pycolmap.Device.cpu,
        )


def _incremental(pycolmap: Any, seed: int) -> Any:
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=1,
        random_seed=seed % SEEDS,
        min_num_matches=MIN_MATCHES,
        min_model_size=PLACED,
        extract_colors=False,
    )
    # Small pictures have fewer matches than COLMAP's 30 for a further view.
    options.mapper.abs_pose_min_num_inliers = MIN_MATCHES
    return options


def _placed(model: Any, names: list[str], folder: Path) -> Registered:
    images = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: names.index(i.name))
    ids = sorted(model.points3D)
    row = {point: i for i, point in enumerate(ids)}
    seen = []
    for image in images:
        found = [p for p in image.points2D if p.has_point3D()]
        pixels = np.array([p.xy for p in found], np.float64).reshape(-1, 2)
        rays = np.asarray(image.camera.cam_from_img(pixels), np.float64)
        seen.append(Observed(np.array([row[p.point3D_id] for p in found], np.intp), pixels, rays))
    return Registered(
        indices=tuple(names.index(image.name) for image in images),
        viewmats=np.stack([np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in images]),
        lenses=tuple(colmap_lens(i.camera, i.camera.width, i.camera.height, folder) for i in images),
        points=np.array([model.points3D[i].xyz for i in ids], np.float64).reshape(-1, 3),
        seen=tuple(seen),
        error=float(model.compute_mean_reprojection_error()),
    )
