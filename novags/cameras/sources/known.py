"""The set's own cameras."""

from dataclasses import dataclass

import numpy as np

from novags.cameras.source import CameraConfig, CameraSource
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class KnownConfig(CameraConfig):
    """The cameras of the set, with stated errors."""

    rotation_deg: float = 0.0  # root-mean-square angle by which cameras are rotated, about random axes
    translation: float = 0.0  # root-mean-square distance by which camera centres are moved, scene extents
    depth_error: float = 0.0  # standard deviation of the log of each view's depth factor; needs a set with depth

    def __post_init__(self) -> None:
        for name in ("rotation_deg", "translation", "depth_error"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} of known cameras must be finite and >= 0, got {getattr(self, name)}")


def check(config: KnownConfig) -> None:
    """Nothing has to be installed."""


SOURCE = CameraSource(
    "the set's own cameras, exact or with stated errors",
    KnownConfig,
    check,
    Later("novags.cameras.known:known"),
    "set",
)
