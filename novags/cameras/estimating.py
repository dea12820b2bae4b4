"""Cameras and first points, from whichever source a configuration belongs to."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras import source_of
from novags.cameras.estimate import CameraEstimate
from novags.cameras.source import CameraConfig, Progress
from simscenes.sets.multiview import MultiviewSet


def estimate_cameras(
    config: CameraConfig,
    multiview: MultiviewSet,
    indices: list[int],
    dark: Tensor,
    *,
    pictures: NDArray[np.uint8] | None = None,
    n_points: int,
    seed: int = 0,
    device: str | torch.device = "cpu",
    progress: Progress | None = None,
) -> CameraEstimate:
    """Cameras and first points of some views, from the source that `config` belongs to.

    Args:
        config: Of one of `SOURCES`.
        multiview: The set. `known` takes cameras and depth from it, `sfm` and `hloc` intrinsics, networks what their
            setting `known` says.
        indices: The requested views.
        dark: [C, h, w, 3] their dark images, 0..1; points take their colours from these.
        pictures: [C, h, w, 3] uint8, the pictures that `config.looks_at` names, for all sources but `known`. None:
            `dark` as 8-bit codes, the meaning of "raw".
        n_points: How many points; a network with a point for each pixel has at most those.
        seed: Of every random choice.
        device: Where a network runs.
        progress: Called with (done, total, what), by `sfm` and `hloc`.

    Raises:
        ValueError: If the source cannot run here, refuses its input, or places fewer than 2 views.
    """
    source = source_of(config)
    how: dict[str, Any] = {"n_points": n_points, "config": config, "seed": seed}
    if source.takes == "set":
        return source.estimate(multiview, indices, dark, **how)
    if pictures is None:
        if config.looks_at != "raw":
            raise ValueError(f"cameras from {config.looks_at} pictures need these pictures, got None")
        pictures = (dark.detach().cpu() * 255).round().to(torch.uint8).numpy()
    if source.takes == "pictures":
        return source.estimate(pictures, dark, **how, device=device)
    if source.takes == "pictures and cameras":
        rig = multiview.rig
        cameras = replace(rig, viewmats=rig.viewmats[indices], Ks=rig.Ks[indices])
        return source.estimate(pictures, cameras, dark, **how, device=device)
    if source.takes == "numbered pictures and lenses":
        how["indices"] = tuple(indices)
    return source.estimate(pictures, multiview.rig.Ks[indices], dark, **how, progress=progress)
