"""Calibrate the camera model of 3DGS4LL on the views of one scene that are known dark and lit."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from novags.methods.calibrated.camera_model import Calibration, CameraModel, amplified, smoothed

STEPS, RATE = 800, 0.02  # of Adam, over all pixels in each step; the rate falls to nothing
BLUR = 1.0  # px: what is calibrated is the smoothed picture, which targets are


def calibrate(dark: Tensor, lit: Tensor, made: dict[str, Any], progress: Callable[[int, int], None]) -> Calibration:
    """The calibration that has the least squared error.

    Args:
        dark: [C, H, W, 3], sRGB codes 0..1, noisy.
        lit: The same views in good light [C, H, W, 3].
        made: On what it is calibrated, for the record.
        progress: Called with the steps done, and of how many.

    Returns:
        First gain, gamma and balance of the amplified target, then the two models. Lit codes are predicted of dark ones
        smoothed, as targets are; dark ones of lit ones pixel by pixel, where noise is in the target and biases nothing.

    Raises:
        ValueError: If the pictures do not fit together.
    """
    if dark.shape != lit.shape or dark.ndim != 4 or dark.shape[-1] != 3:
        raise ValueError(f"dark and lit must both be [C, H, W, 3], got {list(dark.shape)} and {list(lit.shape)}")
    dark, lit = dark.double(), lit.double()
    whole = 3 * STEPS
    first = torch.zeros(4, dtype=torch.float64, requires_grad=True)  # logarithms, beside a gain of 2 and a gamma of 2.2

    def target() -> Tensor:
        gain, gamma, balance = _toned(first)
        return amplified(dark, gain, gamma) * balance

    _descend([first], lambda: _error(target(), lit, BLUR), lambda step: progress(step, whole))
    gain, gamma, balance = (value.detach() for value in _toned(first))
    shown = amplified(dark, gain, gamma)
    to_lit = _fitted(shown, lit, BLUR, lambda step: progress(STEPS + step, whole))
    to_dark = _fitted(lit, dark, 0.0, lambda step: progress(2 * STEPS + step, whole))
    red, green, blue = balance.tolist()
    return Calibration(float(gain), float(gamma), (red, green, blue), to_lit, to_dark, made)


def _toned(logs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gain, gamma and balance; the balance of green is 1, since the gain has it already."""
    return 2 * logs[0].exp(), 2.2 * logs[1].exp(), torch.stack([logs[2], logs.new_zeros(()), logs[3]]).exp()


def _fitted(before: Tensor, after: Tensor, blur: float, said: Callable[[int], None]) -> CameraModel:
    """The model from one set of pictures to another.

    It starts at the gains of least squares: from a gain of 1, dark codes are reached by an overshoot below 0, where the
    clip has no slope and a channel stays black.
    """
    gain = (before * after).sum((0, 1, 2)) / (before**2).sum((0, 1, 2)).clamp_min(1e-12)  # of a black channel: 0
    model = replace(CameraModel.first(), gain=gain)
    parts = [part.requires_grad_() for part in (model.matrix, model.gain, model.offset, model.slopes)]
    _descend(parts, lambda: _error(model(before), after, blur), said)
    return CameraModel(*(part.detach() for part in parts))


def _error(pictures: Tensor, lit: Tensor, blur: float) -> Tensor:
    return sum(((smoothed(one, blur) - other) ** 2).mean() for one, other in zip(pictures, lit, strict=True)) / len(lit)


def _descend(parts: Iterable[Tensor], error: Callable[[], Tensor], said: Callable[[int], None]) -> None:
    adam = torch.optim.Adam(parts, lr=RATE)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(adam, STEPS)
    for step in range(STEPS):
        adam.zero_grad()
        error().backward()
        adam.step()
        falling.step()
        said(step + 1)
