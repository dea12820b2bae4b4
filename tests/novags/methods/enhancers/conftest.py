"""The guided filter and convolutions written out, with loops over pixels; official weights and dark photographs."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from sensor_model import linear_to_srgb, srgb_to_linear

CHECKPOINTS = Path(__file__).resolve().parents[5] / "shared" / "checkpoints"


def window(values: np.ndarray, y: int, x: int, radius: int) -> np.ndarray:
    return values[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]


def smooth(plane: np.ndarray, radius: int, epsilon: float) -> np.ndarray:
    a, b, out = np.empty_like(plane), np.empty_like(plane), np.empty_like(plane)
    for y, x in np.ndindex(plane.shape):
        near = window(plane, y, x, radius)
        a[y, x] = near.var() / (near.var() + epsilon)
        b[y, x] = near.mean() * (1 - a[y, x])
    for y, x in np.ndindex(plane.shape):
        out[y, x] = window(a, y, x, radius).mean() * plane[y, x] + window(b, y, x, radius).mean()
    return out


@pytest.fixture(name="window")
def window_by_hand() -> Callable[[np.ndarray, int, int, int], np.ndarray]:
    """What lies within a radius of a pixel."""
    return window


@pytest.fixture
def smooth_by_hand() -> Callable[[np.ndarray, int, float], np.ndarray]:
    """A plane, radius and epsilon to the plane guided by itself."""
    return smooth


def conv(x: np.ndarray, weight: np.ndarray, bias: np.ndarray | None, pad: int, stride: int = 1) -> np.ndarray:
    outputs, _, size = weight.shape[:3]
    wide = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
    height, width = ((n - size) // stride + 1 for n in wide.shape[1:])
    found = np.zeros((outputs, height, width))
    for o, i, j in np.ndindex(found.shape):
        found[o, i, j] = (weight[o] * wide[:, stride * i : stride * i + size, stride * j : stride * j + size]).sum()
    return found if bias is None else found + np.asarray(bias)[:, None, None]


@pytest.fixture
def conv_by_hand() -> Callable[..., np.ndarray]:
    """(x [C, H, W], weight [O, C, k, k], bias, zeros around x, stride) -> the convolution, one sum a pixel."""
    return conv


@pytest.fixture(scope="session")
def official() -> Callable[[str], Path]:
    """A function: name of an official file of weights -> its path; the test is skipped where it is not."""

    def path(name: str) -> Path:
        found = CHECKPOINTS / name
        if not found.is_file():
            # They are other people's, under licences of their own, so they are never part of this project.
            pytest.skip(f"the official weights {name} are not beside this checkout")
        return found

    return path


@pytest.fixture
def dark_fox(fox: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of photographs [h, w, 3], sRGB code: with a twelfth of the light and a little noise, and as they are."""
    rng = np.random.default_rng(0)
    pairs = []
    for path in sorted((fox / "images").iterdir())[::25]:
        whole = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        bright = cv2.resize(whole, (45, 80), interpolation=cv2.INTER_AREA) / 255.0
        light = srgb_to_linear(bright) / 12
        noisy = light + rng.normal(0, 1, light.shape) * np.sqrt(1e-4 * light + 1e-7)
        pairs.append((linear_to_srgb(noisy.clip(0, 1)), bright))
    return pairs


@pytest.fixture
def plausible() -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    """Asserts that a picture is a dark one made bright: its structure and its colours are those of the bright twin."""

    def check(dark: np.ndarray, found: np.ndarray, bright: np.ndarray) -> None:
        assert found.mean() > 1.6 * dark.mean()
        grey = [picture.mean(-1).ravel() for picture in (found, bright)]
        assert np.corrcoef(*grey)[0, 1] > 0.9
        shares = [picture.reshape(-1, 3).mean(0) / picture.mean() / 3 for picture in (found, bright)]
        np.testing.assert_allclose(*shares, atol=0.04)

    return check
