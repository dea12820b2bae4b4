"""Claims about the light that a capture measured: its zero, its white, and the matrix between camera and display."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from novags.methods.light import brightness, first_light, measured_light
from novags.methods.noise import Noise, Variance
from novags.methods.problem import RawPictures
from sensor_model import NoiseCurve, srgb_to_linear

BLACK, FILES, WHITE = 110.0, 100.0, 1100.0  # DN: where the noise model and where the files have their zero
BALANCE = (2.0, 1.0, 1.6)


def curve(black: float, white: float, **more: tuple[float, ...]) -> NoiseCurve:
    never = (float("inf"),) * 3
    parts = {"offset": (4.0, 5.0, 6.0), "slope": (2.0, 3.0, 4.0), "quadratic": (0.0,) * 3, "step": (0.0,) * 3} | more
    return NoiseCurve(black=(black,) * 3, white=(white,) * 3, switch=never, **parts)


def frames(dn: torch.Tensor) -> RawPictures:
    return RawPictures(dn=dn, cfa=None, black=FILES, white=WHITE, balance=BALANCE)


def test_light_of_raw_frames_is_zero_at_the_models_black_and_one_is_the_files_range_over_the_balance() -> None:
    unit = torch.tensor([500.0, 1000.0, 625.0])
    dn = torch.stack([torch.full((2, 2, 3), BLACK), BLACK + unit.expand(2, 2, 3), BLACK + 2 * unit.expand(2, 2, 3)])
    noise = Noise(Variance(curve(0.0, 1.0)), Variance(curve(BLACK, WHITE)), "camera")
    found = measured_light(noise, frames(dn), None, ())
    torch.testing.assert_close(found.light, torch.tensor([0.0, 1.0, 2.0])[:, None, None, None].expand(3, 2, 2, 3))
    # White, 1100 DN, lies 990 DN above the model's zero.
    torch.testing.assert_close(found.white, 990 / unit)
    torch.testing.assert_close(torch.tensor(found.noise.curve.white), 990 / unit)
    variance = found.noise(torch.tensor([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]))
    electrons = torch.tensor([[0.0] * 3, (0.5 * unit).tolist()])
    expected = (torch.tensor([4.0, 5.0, 6.0]) + torch.tensor([2.0, 3.0, 4.0]) * electrons) / unit**2
    torch.testing.assert_close(variance, expected, check_dtype=False)


def test_points_begin_with_the_light_of_the_camera_behind_its_matrix() -> None:
    """The display shows matrix @ camera: of a mixing matrix the inverse leads back."""
    matrix = torch.tensor([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]])
    colors = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    shown = torch.from_numpy(np.asarray(srgb_to_linear(colors.numpy()), np.float32))
    start = SimpleNamespace(colors=colors)
    data = SimpleNamespace(matrix=matrix)
    torch.testing.assert_close(first_light(start, data) @ matrix.T, shown)  # type: ignore[arg-type]
    data.matrix = None
    torch.testing.assert_close(first_light(start, data), shown)  # type: ignore[arg-type]


def test_brightness_is_near_the_brightest_measured_green() -> None:
    light = torch.linspace(0, 1, 3000).reshape(1, 10, 100, 3)
    light[..., 0] = 50.0
    light[0, 0, 0, 1] = torch.nan
    found = brightness(SimpleNamespace(light=light))  # type: ignore[arg-type]
    assert 0.9 < found < 1.0
    with pytest.raises(ValueError, match="must be above black"):
        brightness(SimpleNamespace(light=-light.abs()))  # type: ignore[arg-type]
