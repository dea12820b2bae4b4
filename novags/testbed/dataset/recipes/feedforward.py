"""Views for feed-forward reconstruction from the dark: each at several light levels, with depth and camera.

dark         uint16 [L, 3, h, w]  linear codes of the dark pictures, `black` without light, `white` at saturation
lit          uint8 [3, h, w]      the view in good light, sRGB
depth        float32 [h, w]       along the camera's axis, scene units; inf where a ray meets no surface
electrons    float32 [L]          mean signal of green, e-
black, white float32 []           codes
viewmat, K   float32 [4, 4], [3, 3]  the camera

Every view can be a target. The index names its context: the nearest training views, the best first, from which a
network takes as many as it wants. Held-out views are never context, so a network that is scored on the held-out views
of a scene sees what methods that train on the scene see.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from novags.testbed.dataset.recipes.packing import planes
from novags.testbed.dataset.recipes.recipe import Group, Recipe, Sample
from novags.testbed.study.cells.presets import Preset
from sensor_model.isp import LINEAR16_BLACK
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.png import read_codes

CONTEXT = 8  # views that the index names; a novel view between more is rarely seen by all


def check(presets: Sequence[Preset]) -> None:
    """Refuse sets without a context for every target.

    Raises:
        ValueError: If there are too few views.
    """
    if (views := presets[0].render.n_views) < 4:  # of 4, one is held out: two others for each of the rest
        raise ValueError(f"views must be >= 4, so that every view has two others as context, got {views}: add some")


def pixel_bytes(presets: Sequence[Preset]) -> float:
    """Three codes of two bytes at each light level, three of one in good light, depth."""
    return 6 * len(presets) + 3 + 4


def context_of(views: MultiviewSet, i: int, depth: float) -> list[int]:
    """The training views nearest to view `i`, other than itself, the nearest first; `CONTEXT` at most.

    Near is a small angle: between the axes of both cameras, plus the parallax of a surface at `depth`.

    Raises:
        ValueError: If there are fewer than two.
    """
    viewmats = np.asarray(views.rig.viewmats, np.float64)
    centres = -np.einsum("nji,nj->ni", viewmats[:, :3, :3], viewmats[:, :3, 3])
    turned = np.arccos(np.clip(viewmats[:, 2, :3] @ viewmats[i, 2, :3], -1, 1))  # rounding passes 1: it would be NaN
    apart = turned + np.arctan2(np.linalg.norm(centres - centres[i], axis=1), depth)
    found = sorted((j for j in views.train_indices if j != i), key=lambda j: float(apart[j]))[:CONTEXT]
    if len(found) < 2:
        raise ValueError(f"{views.path}: view {views.names[i]} must have two other training views as context, got "
                         f"{len(found)}: render more views")  # fmt: skip
    return found


def samples(group: Group) -> Iterator[Sample]:
    """One of each view.

    Raises:
        ValueError: If a set has no depth, or no surface.
    """
    views = group.views
    depths = [_depth(views, i) for i in range(len(views))]
    seen = np.concatenate([depth[np.isfinite(depth)] for depth in depths])
    if not seen.size:
        raise ValueError(f"{views.path}: no view sees a surface, which depth is of: leave the scene out")
    near, middle, far = (float(value) for value in np.quantile(seen, (0, 0.5, 1)))
    for i, name in enumerate(views.names):
        dark = [planes(read_codes(level.capture.path / "images16" / f"{name}.png")) for level in group.levels]
        scalars = {
            "electrons": [level.electrons for level in group.levels], "black": LINEAR16_BLACK, "white": 65535,
            "viewmat": views.rig.viewmats[i], "K": views.rig.Ks[i],
        }  # fmt: skip
        arrays = {"dark": np.stack(dark), "lit": planes(views.image(i)), "depth": depths[i]}
        arrays |= {kind: np.asarray(value, np.float32) for kind, value in scalars.items()}
        row = {
            "sensor": group.levels[0].capture.record.sensor_name, "view": name, "near": f"{near:.6g}",
            "electrons": " ".join(f"{level.electrons:g}" for level in group.levels), "far": f"{far:.6g}",
            "held_out": int(i in views.test_indices),
            "context": " ".join(views.names[j] for j in context_of(views, i, middle)),
        }  # fmt: skip
        yield Sample(name, row, arrays)


def _depth(views: MultiviewSet, i: int) -> NDArray[np.float32]:
    geometry = views.geometry(i)
    if geometry is None:
        raise ValueError(f"{views.path}: view {views.names[i]} has no depth: render the set again")
    return np.asarray(geometry["z"], np.float32)


FEEDFORWARD = Recipe(
    "context and target views at all light levels, in good light, with depth", check, pixel_bytes, samples
)
