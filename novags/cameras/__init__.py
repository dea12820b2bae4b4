"""Where cameras and first points come from. `SOURCES` names the sources; `align` compares them to the truth."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import CameraEstimate
from novags.cameras.known import KnownConfig
from novags.cameras.known import known as known_cameras
from novags.cameras.sfm import Progress, SfmConfig, structure_from_motion
from novags.cameras.sfm import check_installed as check_sfm
from novags.cameras.spelling import parse_settings, spell_settings
from novags.cameras.vggt import VggtConfig, vggt_cameras
from novags.cameras.vggt import check_installed as check_vggt
from simscenes.sets.multiview import MultiviewSet

__all__ = ["SOURCES", "CameraConfig", "CameraEstimate", "CameraSource", "KnownConfig", "SfmConfig", "VggtConfig",
           "check_cameras", "estimate_cameras", "parse_cameras", "spell_cameras"]  # fmt: skip

CameraConfig = KnownConfig | SfmConfig | VggtConfig


@dataclass(frozen=True)
class CameraSource:
    """A row of `SOURCES`."""

    description: str  # one line
    config: type[Any]  # a frozen dataclass


SOURCES: dict[str, CameraSource] = {
    "known": CameraSource("the set's own cameras, exact or with stated errors", KnownConfig),
    "sfm": CameraSource("structure from motion on the pictures (COLMAP), intrinsics known", SfmConfig),
    "vggt": CameraSource("the network VGGT, by your own installation and weights", VggtConfig),
}


def parse_cameras(text: str) -> CameraConfig:
    """`known`, `known:rotation_deg=1,translation=0.01`, `sfm:mapper=global`, `vggt:checkpoint=FILE`, ...

    Raises:
        ValueError: If the source or a setting is unknown, given twice or missing, or a value does not fit.
    """
    config: CameraConfig = parse_settings(text, {name: source.config for name, source in SOURCES.items()}, "cameras")
    return config


def spell_cameras(config: CameraConfig) -> str:
    """The shortest text that `parse_cameras` turns into this configuration."""
    return spell_settings(config, {name: source.config for name, source in SOURCES.items()})


def check_cameras(config: CameraConfig) -> None:
    """Raise a ValueError that says what to install or to give if this source cannot run here."""
    if isinstance(config, SfmConfig):
        check_sfm(config)
    elif isinstance(config, VggtConfig):
        check_vggt(config)


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
        multiview: The set. `known` takes cameras and depth from it, `sfm` intrinsics alone, `vggt` nothing.
        indices: The requested views.
        dark: [C, h, w, 3] their dark images, 0..1; points take their colours from these.
        pictures: [C, h, w, 3] uint8, what `sfm` and `vggt` look at: those that `config.pictures` names. None: `dark`
            as 8-bit codes, which is what "raw" means.
        n_points: How many points; `vggt` has at most one for each pixel.
        seed: Of every random choice.
        device: Where a network runs.
        progress: Called with (done, total, what), by `sfm`.

    Raises:
        ValueError: If the source cannot run here, refuses its input, or places fewer than 2 views.
    """
    if isinstance(config, KnownConfig):
        return known_cameras(multiview, indices, dark, n_points=n_points, config=config, seed=seed)
    if pictures is None:
        if config.pictures != "raw":
            raise ValueError(f"cameras from {config.pictures} pictures need these pictures, got None")
        pictures = (dark.detach().cpu() * 255).round().to(torch.uint8).numpy()
    if isinstance(config, SfmConfig):
        Ks = multiview.rig.Ks[indices]
        return structure_from_motion(pictures, Ks, dark, n_points=n_points, config=config, seed=seed, progress=progress)
    return vggt_cameras(pictures, dark, n_points=n_points, config=config, seed=seed, device=device)
