"""ST-LPIPS: its values against a slow version in numpy and doubles, and what is said where its weights are missing."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter
from scipy.signal import correlate

from novags.testbed.metrics import st_lpips as module
from novags.testbed.metrics.st_lpips import SMALLEST, missing, network, st_lpips

# Set-up with the extra `dev` installs the weights. Who installed novags by itself has none: values alone need them.
needs_weights = pytest.mark.skipif(missing() is not None, reason="the weights of ST-LPIPS are not installed")
SHIFT, SCALE = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])


def convolved(x: np.ndarray, kernel: np.ndarray, bias: np.ndarray, pad: int) -> np.ndarray:
    x = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
    return np.stack([correlate(x, k, "valid")[0] + b for k, b in zip(kernel, bias, strict=True)])


def halved(x: np.ndarray) -> np.ndarray:
    x = np.pad(x, ((0, 0), (2, 2), (2, 2)), mode="reflect")
    lines = x[:, :-2] + 2 * x[:, 1:-1] + x[:, 2:]
    return ((lines[:, :, :-2] + 2 * lines[:, :, 1:-1] + lines[:, :, 2:]) / 16)[:, ::2, ::2]


def slow(image: np.ndarray, reference: np.ndarray) -> float:
    """The recipe, layer by layer, in doubles."""
    weights = {name: tensor.double().numpy() for name, tensor in network().items()}

    def layer(x: np.ndarray, name: str, pad: int) -> np.ndarray:
        return convolved(x, weights[f"net.{name}.weight"], weights[f"net.{name}.bias"], pad)

    def pooled(x: np.ndarray) -> np.ndarray:
        return halved(np.stack([maximum_filter(plane, 3)[1:-1, 1:-1] for plane in x]))

    def features(picture: np.ndarray) -> list[np.ndarray]:
        x = ((2 * picture.astype(np.float64) - 1 - SHIFT) / SCALE).transpose(2, 0, 1)
        f0 = np.maximum(halved(layer(x, "slice1.0", 2)), 0)
        f1 = np.maximum(layer(pooled(f0), "slice2.5", 2), 0)
        f2 = np.maximum(layer(pooled(f1), "slice3.9", 1), 0)
        f3 = np.maximum(layer(f2, "slice4.11", 1), 0)
        return [f0, f1, f2, f3, np.maximum(layer(f3, "slice5.13", 1), 0)]

    total = 0.0
    for k, pair in enumerate(zip(features(image), features(reference), strict=True)):
        one, other = (f / (np.sqrt((f**2).sum(0)) + 1e-10) for f in pair)
        total += float((weights[f"lin{k}.model.1.weight"][0] * (one - other) ** 2).sum(0).mean())
    return total


@needs_weights
@pytest.mark.parametrize("size", [(SMALLEST, 26), (33, 24)])
def test_it_is_the_recipe_in_doubles(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    reference = rng.random((*size, 3)).astype(np.float32)
    image = np.clip(reference + 0.2 * rng.standard_normal(reference.shape), 0, 1).astype(np.float32)
    assert st_lpips(image, reference) == pytest.approx(slow(image, reference), rel=2e-5)
    assert st_lpips(reference, reference) == 0.0


@needs_weights
def test_noise_and_blur_cost_more_the_stronger_they_are_and_a_shift_costs_little() -> None:
    rng = np.random.default_rng(1)
    coarse = rng.random((12, 12, 3))
    reference = np.kron(coarse, np.ones((6, 6, 1))).astype(np.float32)
    noise = rng.standard_normal(reference.shape)
    noisy = [st_lpips(np.clip(reference + s * noise, 0, 1).astype(np.float32), reference) for s in (0.02, 0.1, 0.3)]
    assert 0 < noisy[0] < noisy[1] < noisy[2]
    assert st_lpips(np.roll(reference, 1, 1), reference) < noisy[2] / 4


def test_small_pictures_and_missing_weights_are_said_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    small = np.zeros((SMALLEST - 1, 64, 3), np.float32)
    with pytest.raises(ValueError, match="ST-LPIPS needs images of at least 21 x 21 pixels, got 64 x 20"):
        st_lpips(small, small)
    monkeypatch.setattr(module, "PACKAGE", "no_such_package")
    why = missing()
    assert why is not None
    assert "no_such_package is not installed; pip install 'novags[st-lpips]'" in why
