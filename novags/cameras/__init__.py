"""Where cameras and first points come from. `SOURCES` names the sources; `align` compares them to the truth."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras import hloc, sfm
from novags.cameras.colmap import Progress
from novags.cameras.estimate import CameraEstimate
from novags.cameras.hloc import HlocConfig
from novags.cameras.known import KnownConfig
from novags.cameras.known import known as known_cameras
from novags.cameras.networks import dust3r, mast3r, vggsfm, vggt
from novags.cameras.networks.dust3r import Dust3rConfig
from novags.cameras.networks.mast3r import Mast3rConfig
from novags.cameras.networks.vggsfm import VggsfmConfig
from novags.cameras.networks.vggt import VggtConfig
from novags.cameras.sfm import SfmConfig
from novags.cameras.spelling import parse_settings, spell_settings
from simscenes.sets.multiview import MultiviewSet

__all__ = ["SOURCES", "CameraConfig", "CameraEstimate", "CameraSource", "Dust3rConfig", "HlocConfig", "KnownConfig",
           "Mast3rConfig", "SfmConfig", "VggsfmConfig", "VggtConfig", "check_cameras", "estimate_cameras",
           "parse_cameras", "spell_cameras"]  # fmt: skip

CameraConfig = KnownConfig | SfmConfig | HlocConfig | VggtConfig | Dust3rConfig | Mast3rConfig | VggsfmConfig


@dataclass(frozen=True)
class CameraSource:
    """A row of `SOURCES`.

    Attributes:
        description: One line.
        config: A frozen dataclass.
        check: Raises a ValueError that says what to install or to give if the source cannot run with a configuration.
        estimate: Makes cameras and points of what `takes` says and the dark images; its other arguments are n_points,
            config, seed, and a progress or a device.
        takes: What it is given: the whole set; the pictures with their intrinsics, "numbered" with `indices` too, their
            places among all views of the set, for cameras that are known by the order of the pictures; or the pictures
            alone.
    """

    description: str
    config: type[Any]
    check: Callable[[Any], None]
    estimate: Callable[..., CameraEstimate]
    takes: Literal["set", "numbered pictures and lenses", "pictures and lenses", "pictures"]


SOURCES: dict[str, CameraSource] = {
    "known": CameraSource(
        "the set's own cameras, exact or with stated errors", KnownConfig, lambda config: None, known_cameras, "set"
    ),
    "sfm": CameraSource(
        "structure from motion on the pictures (COLMAP), intrinsics known", SfmConfig, sfm.check_installed,
        sfm.structure_from_motion, "pictures and lenses",
    ),
    "hloc": CameraSource(
        "the same with learned features (hloc), by your own installation", HlocConfig, hloc.check_installed,
        hloc.hloc_cameras, "pictures and lenses",
    ),
    "vggt": CameraSource(
        "the network VGGT, by your own installation and weights", VggtConfig, vggt.check_installed, vggt.vggt_cameras,
        "pictures",
    ),
    "dust3r": CameraSource(
        "the network DUSt3R, by your own installation and weights", Dust3rConfig, dust3r.check_installed,
        dust3r.dust3r_cameras, "pictures",
    ),
    "mast3r": CameraSource(
        "the network MASt3R, by your own installation and weights", Mast3rConfig, mast3r.check_installed,
        mast3r.mast3r_cameras, "pictures",
    ),
    "vggsfm": CameraSource(
        "the program VGGSfM, by your own installation and weights", VggsfmConfig, vggsfm.check_installed,
        vggsfm.vggsfm_cameras, "pictures",
    ),
}  # fmt: skip


def parse_cameras(text: str) -> CameraConfig:
    """`known`, `known:rotation_deg=1,translation=0.01`, `sfm:mapper=global`, `dust3r:checkpoint=FILE`, ...

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
    source_of(config).check(config)


def source_of(config: CameraConfig) -> CameraSource:
    """The row that a configuration belongs to."""
    return next(source for source in SOURCES.values() if source.config is type(config))


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
        multiview: The set. `known` takes cameras and depth from it, `sfm` and `hloc` intrinsics, networks nothing.
        indices: The requested views.
        dark: [C, h, w, 3] their dark images, 0..1; points take their colours from these.
        pictures: [C, h, w, 3] uint8, what all but `known` look at: those that `config.pictures` names. None: `dark` as
            8-bit codes, which is what "raw" means.
        n_points: How many points; a network with a point for each pixel has at most those.
        seed: Of every random choice.
        device: Where a network runs.
        progress: Called with (done, total, what), by `sfm` and `hloc`.

    Raises:
        ValueError: If the source cannot run here, refuses its input, or places fewer than 2 views.
    """
    source = source_of(config)
    how: dict[str, Any] = {"n_points": n_points, "config": config, "seed": seed}
    if isinstance(config, KnownConfig):
        return source.estimate(multiview, indices, dark, **how)
    if pictures is None:
        if config.pictures != "raw":
            raise ValueError(f"cameras from {config.pictures} pictures need these pictures, got None")
        pictures = (dark.detach().cpu() * 255).round().to(torch.uint8).numpy()
    if source.takes == "pictures":
        return source.estimate(pictures, dark, **how, device=device)
    if source.takes == "numbered pictures and lenses":
        how["indices"] = tuple(indices)
    return source.estimate(pictures, multiview.rig.Ks[indices], dark, **how, progress=progress)
