"""The training exposures as a scene: they are brought to any requested camera and averaged."""

import math
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from novags.methods.averaging.surface import Array, Mask, SurfaceCamera, seen_together
from novags.methods.averaging.warp import Rules, warp
from novags.methods.problem import encode
from novags.process import give_back
from novags.splats.views import Views
from sensor_model.files.atomic import atomic

SAME_CAMERA = 1e-4  # radians, and distances between cameras: float32 rounds, and a camera source may turn the world
ROWS = 1 << 13  # pixels that are brought at once: 1 kB each, 60 kB where the other picture is eight times finer
LEAST = 1e-12  # of a variance, as a share of the largest: exposures without any noise would be divided by zero


@dataclass(frozen=True)
class EachView:
    """An array of each view, made where it is used: in double precision those of all views take much memory.

    Attributes:
        make: View -> its array.
        count: Of the views.
    """

    make: Callable[[int], Array]
    count: int

    def __iter__(self) -> Iterator[Array]:
        return map(self.make, range(self.count))


@dataclass(frozen=True)
class Average:
    """An average over views.

    Attributes:
        mean: Linear light [n, 3], 0 where no view sees the pixel.
        variance: Of the mean, from the exposures' own variances [n, 3]; inf where no view sees the pixel.
        views: How many views see it [n].
    """

    mean: Array
    variance: Array
    views: NDArray[np.intp]


def average(
    target: SurfaceCamera, sources: list[SurfaceCamera], exposures: Iterable[Array], variances: Iterable[Array],
    rules: Rules, rows: NDArray[np.intp] | None = None,
) -> Average:  # fmt: skip
    """The exposures [h, w, 3] brought to a camera and averaged by inverse variance, which is the best that can be
    done with independent data of known variance (Gauss-Markov).

    Args:
        target: The camera.
        sources: Cameras of the exposures.
        exposures: Linear light.
        variances: Of the exposures' noise, > 0, the same shapes.
        rules: When a view counts as seeing a pixel.
        rows: Flat indices [n] of the wanted pixels; None: all.
    """
    rows = np.arange(math.prod(target.size)) if rows is None else rows
    total, weight = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    views = np.zeros(len(rows), int)
    for source, exposure, variance in zip(map(replace, sources), exposures, variances, strict=True):
        for begin in range(0, len(rows), ROWS):
            some = slice(begin, begin + ROWS)
            matrix, seen = warp(target, source, rows[some], rules)
            noise = matrix.power(2) @ variance.reshape(-1, 3)
            share = np.where(seen[:, None], 1 / np.where(seen[:, None], noise, 1.0), 0.0)
            total[some] += share * (matrix @ exposure.reshape(-1, 3))
            weight[some] += share
            views[some] += seen
        give_back()  # else the memory of a source stays beside the memory of the next
    found = views > 0
    inverse = 1 / np.where(found[:, None], weight, 1.0)
    return Average(total * inverse, np.where(found[:, None], inverse, np.inf), views)


@dataclass
class AveragedScene:
    """See the module.

    Attributes:
        sources: Cameras of the exposures.
        exposures: Linear light [h, w, 3] of each.
        variances: Of the exposures' noise.
        known: Every camera whose surface is known, held-out ones too.
        rules: When a view counts as seeing a pixel; where none does, edges and coarse pixels count too.
        enhance: (sRGB-encoded [h, w, 3], index of the training view whose camera is the nearest) -> enhanced.
    """

    sources: list[SurfaceCamera]
    exposures: Iterable[Array]
    variances: Iterable[Array]
    known: list[SurfaceCamera]
    rules: Rules
    enhance: Any
    _holes: dict[str, int] = field(default_factory=dict, repr=False)

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `reconstruction.Scene` says. Holes, which no exposure sees, take the colour of the nearest other pixel."""
        found = [self._view(viewmat, K, views) for viewmat, K in zip(views.viewmats, views.Ks, strict=True)]
        image, alpha, depth = (torch.stack(parts).to(views.viewmats.device) for parts in zip(*found, strict=True))
        return image, alpha, depth

    def _view(self, viewmat: Tensor, K: Tensor, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        target = self.camera(viewmat.cpu().double().numpy(), K.cpu().double().numpy(), views.height, views.width)
        found = self.averaged(target)
        seen = (found.views > 0).reshape(target.size)
        image = filled(found.mean.reshape(*target.size, 3), seen)
        surface = seen & (target.inverse_depth > 0)
        depth = np.where(surface, 1 / np.where(surface, target.inverse_depth, 1.0), 0.0)
        enhanced = self.enhance(torch.from_numpy(encode(image)), self._nearest(target))
        self._holes[f"{viewmat.tolist()}"] = int((~seen).sum())
        return enhanced, torch.from_numpy(surface.astype(np.float32)), torch.from_numpy(depth.astype(np.float32))

    def averaged(self, target: SurfaceCamera) -> Average:
        """The average for all pixels of a camera."""
        found = average(target, self.sources, self.exposures, self.variances, self.rules)
        if not len(missing := np.flatnonzero(found.views == 0)):
            return found
        lenient = replace(self.rules, mixed=True, coarsest=np.inf)
        more = average(target, self.sources, self.exposures, self.variances, lenient, missing)
        for whole, part in zip(vars(found).values(), vars(more).values(), strict=True):
            whole[missing] = part
        return found

    def camera(self, viewmat: Array, K: Array, height: int, width: int) -> SurfaceCamera:
        """The camera with its surface: the known one, or for another camera the joint surface of all known cameras."""
        reach = _reach(self.known)
        for camera in self.known:
            turn, shift = _apart(camera.viewmat, viewmat)
            if turn <= SAME_CAMERA and shift <= SAME_CAMERA * reach and camera.size == (height, width):
                return replace(camera)
        return seen_together(self.known, viewmat, K, height, width)

    def _nearest(self, target: SurfaceCamera) -> int:
        reach = _reach(self.known)
        apart = [_apart(camera.viewmat, target.viewmat) for camera in self.sources]
        return int(np.argmin([turn + shift / reach for turn, shift in apart]))

    def save(self, folder: Path) -> None:
        """Write the exposures with their cameras and surfaces, scene/exposures.npz."""
        count = len(self.sources)
        parts: dict[str, Callable[[], Iterable[Array]]] = {
            "viewmats": lambda: (camera.viewmat for camera in self.sources),
            "Ks": lambda: (camera.K for camera in self.sources),
            "variances": lambda: (variance.astype("f4") for variance in self.variances),
            "planes": lambda: (camera.planes.astype("f4") for camera in map(replace, self.sources)),
            "exposures": lambda: (exposure.astype("f4") for exposure in self.exposures),
        }
        # as np.savez_compressed does, which wants the arrays of all views at once
        with (
            atomic(folder / "scene" / "exposures.npz") as temporary,
            zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            for name, each in parts.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    for i, array in enumerate(each()):
                        if i == 0:
                            head = {"descr": array.dtype.str, "fortran_order": False, "shape": (count, *array.shape)}
                            np.lib.format.write_array_header_1_0(file, head)
                        file.write(array.tobytes())

    def facts(self) -> dict[str, Any]:
        """How many exposures there are, and how many pixels of all rendered views none of them sees."""
        size = math.prod(self.known[0].size)
        return {"exposures": len(self.sources), "holes": sum(self._holes.values()),
                "pixels": size * len(self._holes)}  # fmt: skip


def filled(image: Array, seen: Mask) -> Array:
    """The image [h, w, 3], its holes filled with the colour of the nearest seen pixel; all 0 if no pixel was seen."""
    if seen.all() or not seen.any():
        return np.where(seen[..., None], image, 0.0)
    row, column = distance_transform_edt(~seen, return_distances=False, return_indices=True)
    return np.asarray(image[row, column])


def _apart(one: Array, other: Array) -> tuple[float, float]:
    """Angle between two cameras in radians, and the distance between their centres."""
    # From the chord: the arc cosine of a trace loses half the digits near zero.
    turn = 2 * np.arcsin(min(1.0, float(np.linalg.norm(one[:3, :3] - other[:3, :3])) / np.sqrt(8)))
    centres = [-pose[:3, :3].T @ pose[:3, 3] for pose in (one, other)]
    return float(turn), float(np.linalg.norm(centres[0] - centres[1]))


def _reach(cameras: list[SurfaceCamera]) -> float:
    """The largest distance of a camera from their mean; 1 for cameras in one place."""
    centres = np.stack([-camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3] for camera in cameras])
    return float(np.linalg.norm(centres - centres.mean(0), axis=1).max()) or 1.0
