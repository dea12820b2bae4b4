"""The published data sets, one row each, and which of them a folder is of.

A scene is a folder. LOM is known by the content of its scenes, RealX3D by numbers or lit twins of its pictures. The
others look like many folders, so that a folder above has to bear the name of the data set, in upper or lower case.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from novags.testbed.importing.published import lom, posed, realx3d
from novags.testbed.importing.split import Split
from sensor_model.files.reading import some
from simscenes.sets.multiview import MultiviewSet

DEPTH = 4  # folders below the searched one
NEAR = 3  # folders above a scene whose names count: farther up a name says where somebody works, not on which data


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """A published data set.

    Attributes:
        name: As its authors write it.
        home: Where it is available.
        layout: A scene in a few words.
        named: Whether a folder above a scene bears the name; else the content of the scene is enough.
        fits: Whether a folder holds the files of a scene.
        open_scene: The dark pictures of a scene with their cameras.
        lit: The folder of a scene's well-lit pictures; None if it has none.
        by_order: Lit and dark pictures pair by the order of their names, not by their names.
        proves: Whether the content of a folder leaves no doubt, whatever the folders above it are called.
        scene_name: What a scene is called beside the others.
        beside: Other files that are read, outside the folder too: "depth/NAME", which `realx3d.read_depth` reads, is
            the measured depth of a view, "scan" a PLY file of measured points in metres.
    """

    name: str
    home: str
    layout: str
    named: bool
    fits: Callable[[Path], bool]
    open_scene: Callable[[Path, Split], MultiviewSet]
    lit: Callable[[Path], Path | None]
    by_order: bool = False
    proves: Callable[[Path], bool] = lambda folder: False
    scene_name: Callable[[Path], str] = lambda folder: folder.name
    beside: Callable[[Path, MultiviewSet], dict[str, Path]] = lambda folder, views: {}

    def holds(self, folder: Path) -> bool:
        """Whether a folder is a scene of this data set."""
        return self.fits(folder) and (not self.named or _owner(folder) == self.name or self.proves(folder))


_ROWS = (
    Dataset(
        name="LOM", home="https://github.com/cuiziteng/Aleth-NeRF",
        layout="low/, high/, transforms_train.json, transforms_test.json, colmap_sparse/", named=False,
        fits=lom.is_scene, open_scene=lom.open_scene, lit=lambda folder: folder / lom.LIT,
    ),
    Dataset(
        name="LLNeRF", home="https://github.com/onpix/LLNeRF",
        layout="images/, sparse/0 or poses_bounds.npy; lit pictures in normal-light-scenes/SCENE beside it", named=True,
        fits=posed.has_cameras, open_scene=posed.open_scene, lit=posed.lit_beside, by_order=True,
    ),
    Dataset(
        name="LLRS", home="https://github.com/sunhao242/LL-Gaussian",
        layout="images/, sparse/0 or poses_bounds.npy, lit pictures in gt/images/", named=True,
        fits=posed.has_cameras, open_scene=posed.open_scene, lit=posed.lit_inside,
    ),
    Dataset(
        name="MVTV", home="https://github.com/XuJiacong/Thermal-NeRF",
        layout="images/ (visible light, 16-bit PNG or TIFF, or raw), sparse/0 or transforms.json", named=True,
        fits=posed.has_cameras, open_scene=posed.open_scene, lit=posed.lit_inside,
    ),
    Dataset(
        name="RealX3D", home="https://huggingface.co/datasets/ToferFish/RealX3D",
        layout="train/ (dark), val/ (lit, the same names), test/ (lit), sparse/0, transforms_train.json, "
               "transforms_test.json; pointclouds/SCENE of the same release above", named=True,
        fits=realx3d.is_scene, open_scene=realx3d.open_scene, lit=realx3d.lit, proves=realx3d.is_proved,
        scene_name=realx3d.scene_name, beside=realx3d.beside,
    ),
)  # fmt: skip
DATASETS: dict[str, Dataset] = {row.name: row for row in _ROWS}


def dataset_of(folder: Path) -> Dataset | None:
    """The data set that a folder is a scene of; None if it is of none."""
    if any(posed.LIT_BESIDE in place.parts for place in posed.places(folder)):
        return None  # lit pictures, with cameras of their own perhaps
    return next((dataset for dataset in _ROWS if dataset.holds(folder)), None)


def scenes_below(root: Path) -> dict[str, dict[str, Path]]:
    """The scenes of each data set that lie in a folder or at most `DEPTH` folders below, by name, in its order.

    Folders that the user may not read are passed over.

    Raises:
        ValueError: If there is no such folder, or two scenes of a data set have one name.
    """
    if not root.is_dir():
        raise ValueError(f"no such folder: {root}")
    found: dict[str, dict[str, Path]] = {}
    for dataset, folder in _walk(root, DEPTH):
        scenes, name = found.setdefault(dataset.name, {}), dataset.scene_name(posed.places(folder)[0])
        if name in scenes:
            raise ValueError(f"{scenes[name]} and {folder} are both the scene {name} of {dataset.name}: move one away")
        scenes[name] = folder
    return {name: dict(sorted(found[name].items())) for name in DATASETS if name in found}


def _walk(folder: Path, depth: int) -> Iterator[tuple[Dataset, Path]]:
    if (dataset := dataset_of(folder)) is not None:
        yield dataset, folder
    elif depth:
        for below in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
            with suppress(PermissionError):  # others' folders, and lost+found of a disk
                yield from _walk(below, depth - 1)


def _owner(folder: Path) -> str | None:
    """The data set whose name the nearest folder above bears."""
    for above in (above for place in posed.places(folder) for above in list(place.parents)[:NEAR]):
        for dataset in _ROWS:
            if dataset.named and dataset.name.lower() in above.name.lower():
                return dataset.name
    return None


def expected(names: Iterable[str]) -> str:
    """Where these data sets are available, and the content of a scene of each; for messages."""
    return "; ".join(f"{name}: {DATASETS[name].layout} ({DATASETS[name].home})" for name in names)


def scene_names(scenes: dict[str, dict[str, Path]]) -> str:
    """Some scenes, for messages."""
    return some([f"{dataset}/{scene}" for dataset, found in scenes.items() for scene in found], 8)
