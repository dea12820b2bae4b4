"""The subject of a capture: a multiview set, rendered or real, optionally scaled down.

Radiance is float32 linear RGB [h,w,3]; lit images are float32 sRGB-encoded [h,w,3], 0..1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from novags.cameras.doubts import camera_doubts, few_views, lens_doubts, same_photographs
from novags.numbers import SSIM_WINDOW
from novags.testbed.console.terminal import Console, warnings_as_notes
from novags.testbed.folders.exchanged import refuse_exchanged
from novags.testbed.folders.photographs.raw_files import is_raw, read_colors, skipped_steps
from novags.testbed.ledger.contents import folder_digest, read_json
from sensor_model.files.door import enter
from sensor_model.files.reading import some
from sensor_model.files.records import Reads, read_once
from sensor_model.files.registry import Registry
from sensor_model.isp import linear_to_srgb
from simscenes.rigs import Rig
from simscenes.sets.geometry.plausible import with_tested_tracks
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.multiview import READERS, MultiviewSet, is_rendered, load_set
from simscenes.sets.pictures.image_file import WITH_ALPHA, has_alpha, header, stated_curve
from simscenes.sets.pictures.meaning import other_primaries
from simscenes.sets.readers.bare import looks_like_mask
from simscenes.sets.readers.llff import POSES
from simscenes.sets.readers.nerf_synthetic import PARTS

# Files of a set besides its images: our own record and truth, and the cameras in every supported form.
MODEL = tuple(f"{part}.{suffix}" for part in ("cameras", "images", "points3D") for suffix in ("bin", "txt"))
READ_FROM = ("set.json", "capture.json", "transforms.json", *PARTS, POSES, "nb-info.json", "sparse", "sparse/0",
             "colmap_sparse", "colmap/sparse", "gt", *MODEL)  # fmt: skip

# How codes of 16 bits are taken.
WORDS = {"linear": "linear light", "srgb": "sRGB-encoded, as the files say"}
EXPOSURES = 1e30  # more would make NaN of a black pixel in float32
NOISE = 0.01  # of a photograph's bright light: values further below 0 are not noise

# Modules that photographs need and no rendered set, beside `READERS`.
PHOTOGRAPHS: Registry[Callable[..., Any]] = Registry({
    "matching": "novags.cameras.matching:picture_doubts",
    "linear files": "novags.testbed.folders.photographs.linear:load_linear_set",
    "noise": "novags.methods.noise_estimate:noise_from",
})  # fmt: skip


def for_photographs() -> tuple[str, ...]:
    """The modules that photographs need and no rendered set.

    Results of photographs depend on them, and results of rendered sets do not: a correction keeps the latter.
    """
    tables: tuple[Registry[Any], ...] = (PHOTOGRAPHS, READERS)
    return tuple(module for table in tables for name in table if (module := table.module_of(name)))


@dataclass(frozen=True)
class Source:
    """A multiview set seen at the capture's image size."""

    views: MultiviewSet
    rig: Rig  # of the scaled images
    console: Console  # where notes on single views go
    lit_views: frozenset[int] | None = None  # known in good light; None: all; empty: all views are dark
    scan: Path | None = None  # measured points of the scene, in metres like the cameras
    scanned: Mapping[int, Path] = field(default_factory=dict)  # measured depth of views (`imported.write_depth`)
    called: str = ""  # its name in messages; "" is the set and its folder
    reads: Reads = field(default_factory=dict, repr=False, compare=False)  # its JSON files, as opened

    @property
    def lit_known(self) -> bool:
        """Whether a view is known in good light."""
        return self.lit_views is None or bool(self.lit_views)

    def shows(self, i: int) -> bool:
        """Whether view `i` is known in good light."""
        return self.lit_views is None or i in self.lit_views

    @property
    def title(self) -> str:
        """Its name in messages."""
        return self.called or f"the set {self.views.path}"

    @property
    def scaled(self) -> bool:
        """Whether images differ in size from the set's own."""
        return (self.rig.width, self.rig.height) != (self.views.rig.width, self.views.rig.height)

    @property
    def codes16(self) -> str | None:
        """How 16-bit codes of photographs are taken, "linear" or "srgb"; None: the first one has 8 bits."""
        return (stated_curve(self.views.files[0]) or "linear") if self.views.is_deep(0) else None

    @property
    def modules(self) -> tuple[str, ...]:
        """Results made from it depend on these modules, beside the modules that every set needs."""
        return for_photographs() if self.views.kind == "photographs" else ()

    @property
    def filters(self) -> np.ndarray | None:
        """Linear sRGB -> the signal behind the set's own colour filters, [3,3]; None for a set in linear sRGB."""
        matrix = self.views.meta.get("camera_matrix")
        return None if matrix is None else np.array(matrix, np.float64)

    @property
    def response(self) -> tuple[float, float, float] | None:
        """The response of the set's own colour filters to white, green = 1."""
        if self.filters is None:
            return None
        red, green, blue = self.filters.sum(1)
        # A real filter passes a tenth to ten times as much as green; by far beyond it float32 would overflow.
        if not (min(red, green, blue) > 0 and all(1e-3 <= other / green <= 1e3 for other in (red, blue))):
            raise ValueError(f"the camera_matrix of {self.views.path} must have rows with sums > 0, within a factor of "
                             f"1000 of green's, got {red:g}, {green:g}, {blue:g}: put the original back")  # fmt: skip
        return float(red / green), 1.0, float(blue / green)

    @property
    def color_matrix(self) -> np.ndarray | None:
        """From white-balanced RGB of the set's own colour filters to linear sRGB, [3,3]; white stays white."""
        return None if self.filters is None else np.linalg.inv(self.filters) * self.filters.sum(1)

    def picture_doubts(self, picture: Callable[[int], np.ndarray] | None = None) -> list[str]:
        """Doubts about whether pictures of a stranger show what their cameras say.

        Args:
            picture: The 8-bit picture of a view, of the size of `rig`; None: the views', whose files are not raw.
        """
        views = self.views
        if _is_own(views.path) or (picture is None and is_raw(views.files[0])):
            return []
        masks = [name for name, file in zip(views.names, views.files, strict=True) if looks_like_mask(file)]
        found: list[str] = PHOTOGRAPHS["matching"](
            views.names, views.rig.viewmats, (views if picture is None else self).rig.Ks, picture or views.image
        )
        return found + ([] if not masks else [
            f"{len(masks)} of {len(views.names)} pictures look like masks, black and white or of a few flat colours: "
            f"{some(masks)}; a method takes them for what the cameras saw: remove them, or put the photographs back"
        ])  # fmt: skip

    def radiance(self, i: int) -> np.ndarray:
        """Linear RGB of view `i`, averaged over each larger pixel where the source is scaled down.

        A set seen through colour filters of its own is balanced, so that white is white: `response` undoes that.

        Photographs with the black level subtracted have noise around 0: slightly negative values become 0, with a note.

        Raises:
            ValueError: If a value is not finite or more than slightly negative, or the file cannot be read.
        """
        radiance = self.views.radiance(i)
        self._say_background(i)
        rendered = self.views.kind == "rendered"
        if not rendered and radiance.min() < 0 and radiance.min() >= -NOISE * np.quantile(radiance, 0.99):
            self.console.warn(f"{self.views.path} holds light slightly below 0 (noise around black): it counts as 0")
            radiance = np.maximum(radiance, 0)
        bad = ~(np.isfinite(radiance) & (radiance >= 0))
        if bad.any():
            first = tuple(int(k) for k in np.argwhere(bad)[0])
            help = "render the set again" if rendered else f"correct {self.views.files[i].name}, or remove it"
            raise ValueError(
                f"radiance must be finite and >= 0, got {radiance[first]} at {first} in view {self.views.names[i]} of "
                f"{self.title} ({int(bad.sum())} values): {help}"
            )
        if self.response is not None:
            radiance = np.divide(radiance, self.response, dtype=np.float32)
        return self._fit(radiance)

    def lit(self, i: int) -> np.ndarray:
        """The well-lit image of view `i`: the set's own, or the photograph itself.

        Raises:
            ValueError: If there is none, the picture cannot be read, or the set's exposure is out of range.
        """
        if not self.shows(i):
            raise ValueError(f"view {self.views.names[i]} of {self.title} is not known in good light: import its "
                             "well-lit picture too")  # fmt: skip
        if not self.scaled:
            self._say_background(i)
            return self.views.image(i).astype(np.float32) / 255
        return self.shown(self.radiance(i))

    def shown(self, light: np.ndarray) -> np.ndarray:
        """Light in the unit of `radiance`, [h,w,3], as a well-lit picture of this set.

        Raises:
            ValueError: If the set's exposure is out of range.
        """
        exposure = float(self.views.meta.get("exposure_scale", 1.0))
        if not 0 < exposure <= EXPOSURES:
            raise ValueError(
                f"exposure_scale of {self.views.path} must be > 0 and at most {EXPOSURES:g}, got {exposure:g}: "
                "render the set again"
            )
        if self.filters is not None:  # back through the matrix, as the set's own images were made
            light = np.asarray((light * self.response) @ np.linalg.inv(self.filters).T, np.float32)
        with np.errstate(over="ignore"):  # beyond float32 is white
            shown = light * np.float32(exposure)
        return linear_to_srgb(np.clip(shown, 0.0, 1.0)).astype(np.float32)

    def half(self, i: int) -> np.ndarray | None:
        """Half the difference between two independent renders whose mean is `radiance(i)`; None where it is not known,
        of photographs above all.
        """
        if (half := self.views.half(i)) is None:
            return None
        return self._fit(half if self.response is None else np.divide(half, self.response, dtype=np.float32))

    def points(self) -> SparsePoints | None:
        """The set's sparse points with their tracks through the pictures of this size; tested ones where it has none.

        Raises:
            ValueError: If the model, or a picture that has to be looked at, cannot be read.
        """
        return self._points

    @cached_property
    def _points(self) -> SparsePoints | None:
        points = self.views.points()
        if points is None:
            return None
        if not len(points.view):
            points = with_tested_tracks(self.views, points)
        return points.at_size(self.views.rig, self.rig)

    @cached_property
    def content(self) -> str:
        """The result of `digest` when the set was opened; errors as there."""
        with read_once(self.reads):
            return self.digest()

    def digest(self) -> str:
        """Present hash of everything that is read from the set, wherever its files are."""
        images = {f"images/{name}": file for name, file in zip(self.views.names, self.views.files, strict=True)}
        if (points := self.views.points_file) is not None:
            images["ply_file_path"] = points
        return folder_digest(self.views.path, READ_FROM, beside=images)

    def _say_background(self, i: int) -> None:
        """Say that a photograph is before white, where it can be transparent, and which light its codes are."""
        file = self.views.files[i]
        if self.views.is_deep(i):
            curve = stated_curve(file) or "linear"
            self.console.warn(f"pictures of {self.views.path} have 16 bits: their codes are taken as {WORDS[curve]}")
        if self.views.kind == "photographs":
            say_stated(file, self.views.path, self.console)
        if self.views.kind == "photographs" and file.suffix.lower() in WITH_ALPHA and has_alpha(file):
            self.console.warn(f"pictures of {self.views.path} have an alpha channel: the background of their pixels "
                              "counts as white")  # fmt: skip

    def _fit(self, image: np.ndarray) -> np.ndarray:
        if not self.scaled:
            return image
        import cv2

        return cv2.resize(image, (self.rig.width, self.rig.height), interpolation=cv2.INTER_AREA)


def open_source(path: Path, console: Console, max_size: int | None = None) -> Source:
    """Open a multiview set, a folder of posed photographs (8-bit, camera raw or linear EXR), or a COLMAP model.

    Args:
        path: The folder.
        console: Where warnings about the folder go.
        max_size: Longest image side in pixels; larger images are scaled down to it. None keeps them.

    Raises:
        ValueError: If the folder holds no posed images, a file of a set or a capture has changed since it was written,
            or their shortest side is, or becomes, too short for scores.
    """
    enter(path)
    reads: Reads = {}
    with warnings_as_notes(console), read_once(reads):
        refuse_exchanged(path)
        linear = None if is_rendered(path) and (path / "set.json").is_file() else PHOTOGRAPHS["linear files"](path)
        views = linear or load_set(path)
    return replace(source_of(views, console, max_size), reads=reads)


def source_of(views: MultiviewSet, console: Console, max_size: int | None = None) -> Source:
    """The result of `open_source` for the views of a folder that was opened already; arguments and errors as there."""
    path = views.path
    if (path / "capture.json").is_file() and "uneven" in read_json(path / "capture.json"):
        raise ValueError(f"the views of {path} differ in exposure or white balance: as a set or as photographs they "
                         "would show one surface in several brightnesses; use a capture of like views")  # fmt: skip
    if views.renamed and views.kind == "photographs" and not (path / "capture.json").is_file():
        name, file = next(iter(views.renamed.items()))
        console.warn(f"{len(views.renamed)} of {len(views)} files and their views cannot have one name ({file!r}: view "
                     f"{name}); the capture.json of a capture of it names the file of each")  # fmt: skip
    if views.kind == "photographs" and not _is_own(path):  # our own were looked at when their cameras were found
        focals = views.rig.Ks[:, 0, 0] / max(views.rig.width, views.rig.height)
        taken = views.rig.Ks if views.lenses is None else np.stack([lens.K for lens in views.lenses])
        doubts = [*few_views(len(views)), *lens_doubts(taken, (views.rig.width, views.rig.height))]
        doubts += same_photographs(views.files)
        held = views.points() if views.model() is not None else None
        tracked = held is not None and len(held.view) > 0  # points without tracks were not what the cameras came from
        points = held.xyz if held is not None and tracked else None
        seen = np.bincount(held.view, minlength=len(views)).tolist() if held is not None and tracked else None
        for doubt in [*doubts, *camera_doubts(views.names, views.rig.viewmats, focals, points=points, seen=seen)]:
            console.warn(f"{path}: {doubt}")
        say_balances(views.files, console)
    if missing := left_out(views.unregistered, len(views) + len(views.unregistered)):
        console.warn(missing)
    rig = views.rig if max_size is None else scaled_rig(views.rig, max_size)
    if min(rig.width, rig.height) < SSIM_WINDOW:
        larger = "" if max_size is None else f": choose a max_size larger than {max_size}"
        size = f"{rig.width} x {rig.height}"
        raise ValueError(f"the images of {path} must be at least {SSIM_WINDOW} px wide and high, got {size}{larger}")
    return Source(views=views, rig=rig, console=console)


def _is_own(folder: Path) -> bool:
    """Whether it was made here."""
    return any((folder / name).is_file() for name in ("set.json", "capture.json"))


def say_stated(file: Path, folder: Path, console: Console) -> None:
    """Say which statements of a photograph are passed over: colours of other primaries, steps of development."""
    if not is_raw(file) and file.suffix.lower() != ".exr":
        with header(file) as image:
            if other_primaries(file, image):
                console.warn(f"pictures of {folder} state colours of other primaries than those of sRGB (Display P3, "
                             "say): they are taken as sRGB's, which changes saturated colours a little")  # fmt: skip
    if is_raw(file) and (steps := skipped_steps(file)):
        console.warn(f"raw files of {folder} ask for {', '.join(steps)} and let readers pass over it: that is not "
                     "done, so that light and lens are those of the sensor")  # fmt: skip


def say_balances(files: Sequence[Path], console: Console) -> None:
    """Say that raw files state several white balances or colour matrices, and whose count for all."""
    stated = [(file, read_colors(file)) for file in files if is_raw(file)]
    if other := next((file for file, colors in stated if not colors.alike(stated[0][1])), None):
        first = stated[0][0]
        console.warn(f"raw files of {first.parent} state several white balances or colour matrices ({other.name} other "
                     f"ones than {first.name}), as cameras with automatic white balance do: those of {first.name} "
                     "count for all")  # fmt: skip


NAMED = 20  # photographs that a line of the console names


def left_out(names: Sequence[str], photographs: int) -> str:
    """That photographs have no camera, in one line; "" if all have one."""
    if not names:
        return ""
    more = f" and {len(names) - NAMED} more (named in set.json and in the report)" if len(names) > NAMED else ""
    return (f"{len(names)} of {photographs} photographs have no camera and are left out: "
            f"{', '.join(names[:NAMED])}{more}")  # fmt: skip


def scaled_rig(rig: Rig, max_size: int) -> Rig:
    """The same cameras with the longest image side at most `max_size` pixels (aspect kept to the nearest pixel)."""
    longest = max(rig.width, rig.height)
    if longest <= max_size:
        return rig
    width, height = (max(1, round(side * max_size / longest)) for side in (rig.width, rig.height))
    # Scaling keeps pixel edges in place, not centres, so with centres at +0.5 whole rows of K scale.
    scale = np.array([width / rig.width, height / rig.height, 1.0])[:, None]
    return Rig(viewmats=rig.viewmats, Ks=rig.Ks * scale, width=width, height=height)
