"""Claims about what Intel's denoiser is shown, and how much of its answer is taken."""

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from simscenes.render import smooth

SHAPE = (4, 5)


def test_the_denoiser_sees_three_channels_of_albedo_and_normals_and_moves_no_pixel_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It answers 10 everywhere, or -10, where the radiance is 3 with a standard error of 1."""
    seen, answer = list[Any](), [10.0]

    def denoise(raw: Any, albedo: Any, normal: Any, *, hdr: bool) -> Any:
        assert hdr
        seen[:] = raw, albedo, normal
        return np.full_like(raw, answer[0])

    stand_in = ModuleType(smooth.PACKAGE)
    monkeypatch.setattr(stand_in, "denoise", denoise, raising=False)
    monkeypatch.setattr(smooth, "find_spec", lambda name: stand_in)
    monkeypatch.setitem(sys.modules, smooth.PACKAGE, stand_in)
    names = [*(f"albedo.{axis}" for axis in "RGB"), *(f"N.{axis}" for axis in "XYZ")]
    surfaces = {name: np.full(SHAPE, k / 10) for k, name in enumerate(names)}
    radiance, variance = np.full((*SHAPE, 3), 3.0), np.ones((*SHAPE, 3))
    assert (smooth.smoothed(radiance, variance, surfaces) == 5.0).all()
    np.testing.assert_allclose(seen[1], np.broadcast_to([0.0, 0.1, 0.2], (*SHAPE, 3)))
    np.testing.assert_allclose(seen[2], np.broadcast_to([0.3, 0.4, 0.5], (*SHAPE, 3)))
    assert all(part.flags.c_contiguous and part.dtype == np.float32 for part in seen)
    answer[0] = -10.0
    assert (smooth.smoothed(radiance, variance, surfaces) == 1.0).all()
    assert (smooth.smoothed(radiance, 100 * variance, surfaces) == 0.0).all()
