"""The camera model of 3DGS4LL: from dark codes to lit ones, or back, by 63 numbers that one lit scene calibrates.

    y = curve(clip(gain (M x) + offset)),    curve: 16 straight pieces from (0, 0) to (1, 1) for each channel

The slopes of a curve are 16 times a softmax, so that it rises everywhere. Text and code of the publication differ in
the direction: its text brings lit codes to dark ones, its program amplified dark codes to lit ones. Both are calibrated
here; branch 1 needs the first, branch 3 the second. Its own numbers are of the camera of RealX3D, and those of the
curves are not in its text.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from sensor_model.files.door import read_text
from sensor_model.files.reading import reading
from sensor_model.files.records import Numbers, check_shape, parse_json

PACKAGED = Path(__file__).with_name("calibration.json")
PIECES = 16
DIGITS = 5  # of a number in a file: codes have 8 bits
FAINT = 1e-6  # added to codes before a root: the slope of the root at black is infinite
MODEL = {"matrix": Numbers(3, 3), "gain": Numbers(3), "offset": Numbers(3), "slopes": Numbers(3, PIECES)}
SHAPE: Any = {"gain": float, "gamma": float, "balance": Numbers(3), "to_lit": MODEL, "to_dark": MODEL,
              "made": {"*": (str, int, float)}}  # fmt: skip


@dataclass(frozen=True)
class CameraModel:
    """One direction of the model.

    Attributes:
        matrix: M [3, 3].
        gain: [3].
        offset: [3].
        slopes: [3, 16], the logarithms of the slopes up to a constant.
    """

    matrix: Tensor
    gain: Tensor
    offset: Tensor
    slopes: Tensor

    def __call__(self, picture: Tensor) -> Tensor:
        """A picture [..., 3] of codes as the model shows it, 0..1."""
        mixed = (self.gain.to(picture) * (picture @ self.matrix.to(picture).T) + self.offset.to(picture)).clamp(0, 1)
        knots = F.pad(torch.softmax(self.slopes.to(picture), 1).cumsum(1), (1, 0))
        place = (PIECES * mixed).detach().floor().clamp(0, PIECES - 1)
        below = [knots[c].gather(0, place[..., c].long().flatten()).view(mixed.shape[:-1]) for c in range(3)]
        above = [knots[c].gather(0, place[..., c].long().flatten() + 1).view(mixed.shape[:-1]) for c in range(3)]
        low, high = torch.stack(below, -1), torch.stack(above, -1)
        return low + (PIECES * mixed - place) * (high - low)

    @staticmethod
    def first() -> "CameraModel":
        """The model that changes nothing."""
        one, nothing = torch.ones(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
        slopes = torch.zeros(3, PIECES, dtype=torch.float64)
        return CameraModel(torch.eye(3, dtype=torch.float64), one, nothing, slopes)


@dataclass(frozen=True)
class Calibration:
    """What one lit scene says about a camera and its light.

    Attributes:
        gain: K of the first target K code^(1 / gamma) balance.
        gamma: Of that target.
        balance: [3].
        to_lit: From K code^(1 / gamma) to lit codes.
        to_dark: From lit codes to dark ones.
        made: On what it was calibrated.
    """

    gain: float
    gamma: float
    balance: tuple[float, float, float]
    to_lit: CameraModel
    to_dark: CameraModel
    made: dict[str, Any]

    def amplified(self, dark: Tensor) -> Tensor:
        """K code^(1 / gamma) of dark codes, clipped."""
        return amplified(dark, self.gain, self.gamma)


def amplified(dark: Tensor, gain: float | Tensor, gamma: float | Tensor) -> Tensor:
    """K code^(1 / gamma), clipped to 0..1; without `FAINT` a calibration would meet an infinite slope at black."""
    return (gain * (dark.clamp(0, 1) + FAINT) ** (1 / gamma)).clamp(0, 1)


def smoothed(picture: Tensor, sigma: float) -> Tensor:
    """A Gaussian blur of a picture [H, W, C] by `sigma` px, cut at three of them; edges are repeated."""
    if sigma == 0:
        return picture
    reach = max(1, round(3 * sigma))
    weights = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, dtype=torch.float64) / sigma) ** 2)
    return _filtered(picture, (weights / weights.sum()).to(picture))


def mean_of_nine(picture: Tensor) -> Tensor:
    """The 3 x 3 mean of a picture [H, W, C]; edges are repeated."""
    return _filtered(picture, picture.new_full((3,), 1 / 3))


def _filtered(picture: Tensor, weights: Tensor) -> Tensor:
    reach = len(weights) // 2
    planes = F.pad(picture.movedim(-1, 0)[None], (reach,) * 4, mode="replicate")[0][:, None]
    rows = F.conv2d(planes, weights.view(1, 1, 1, -1))
    return F.conv2d(rows, weights.view(1, 1, -1, 1))[:, 0].movedim(0, -1)


def read_calibration(path: Path | None) -> Calibration:
    """A calibration from its file; the packaged one for None.

    Raises:
        ValueError: If the file cannot be read, or is not a calibration.
    """
    path = PACKAGED if path is None else path
    with reading(path, "calibrate again, by novags.methods.calibrated.calibrate"):
        found = parse_json(read_text(path), "the calibration")
        check_shape(found, SHAPE, "the calibration")
        if not (found["gain"] > 0 and found["gamma"] > 0):
            raise ValueError(f"gain and gamma must be > 0, got {found['gain']} and {found['gamma']}")
    models = {
        side: CameraModel(**{name: torch.tensor(value, dtype=torch.float64) for name, value in found[side].items()})
        for side in ("to_lit", "to_dark")
    }
    gain, gamma, balance = float(found["gain"]), float(found["gamma"]), tuple(found["balance"])
    return Calibration(gain, gamma, balance, **models, made=found["made"])


def as_record(calibration: Calibration) -> dict[str, Any]:
    """A calibration as its file has it; `read_calibration` gives it back to `DIGITS` digits."""
    models = {
        side: {name: _rounded(value.tolist()) for name, value in vars(getattr(calibration, side)).items()}
        for side in ("to_lit", "to_dark")
    }
    tone = {name: _rounded(getattr(calibration, name)) for name in ("gain", "gamma", "balance")}
    return {**tone, **models, "made": calibration.made}


def _rounded(value: Any) -> Any:
    return round(value, DIGITS) if isinstance(value, float) else [_rounded(one) for one in value]
