"""Claims about monotone alignment: the exact optimum, its invariances, and what it is blind to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from novags.testbed.metrics.images import gaussian_blur, psnr
from novags.testbed.metrics.tone import affine_aligned, tone_aligned

PROPERTY = settings(derandomize=True, deadline=None, max_examples=50)
Values = list[int]


def as_images(x: Values, y: Values) -> tuple[np.ndarray, np.ndarray]:
    """Two images [1,n,3] whose channels are x and y, x scaled and y reversed, and both mirrored, all in 0..1."""
    a, b = np.array(x, float) / 10, np.array(y, float) / 10
    return np.stack([a, a * 0.5, 1 - a], -1)[None], np.stack([b, b[::-1], 1 - b], -1)[None]


def slow_isotonic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The minimax formula of isotonic regression: max over lower sets of the min over upper sets of means."""
    result = np.empty(len(x))
    for k, value in enumerate(x):
        levels = np.unique(x)
        result[k] = max(
            min(y[(x >= low) & (x <= high)].mean() for high in levels[levels >= value])
            for low in levels[levels <= value]
        )
    return result


pairs = st.integers(1, 9).flatmap(
    lambda n: st.tuples(*(st.lists(st.integers(0, 10), min_size=n, max_size=n) for _ in range(2)))
)


@PROPERTY
@given(pairs)
def test_the_curve_is_the_exact_least_squares_optimum(pair: tuple[Values, Values]) -> None:
    image, reference = as_images(*pair)
    aligned = tone_aligned(image, reference)
    for c in range(3):
        expected = slow_isotonic(image[0, :, c].round(9), reference[0, :, c])
        assert np.abs(aligned[0, :, c] - expected).max() < 1e-6


def test_the_curve_is_the_solution_of_the_quadratic_program() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(5)
    image, reference = rng.integers(0, 6, (1, 14, 3)) / 6.0, rng.uniform(0, 1, (1, 14, 3))
    aligned = tone_aligned(image, reference)
    for c in range(3):
        levels, place = np.unique(image[0, :, c], return_inverse=True)
        found = minimize(
            lambda f, place=place, y=reference[0, :, c]: ((f[place] - y) ** 2).sum(),
            np.full(len(levels), 0.5),
            constraints={"type": "ineq", "fun": np.diff},
            method="SLSQP",
            options={"ftol": 1e-14},
        )
        assert np.abs(aligned[0, :, c] - found.x[place]).max() < 1e-5


@PROPERTY
@given(pairs)
def test_equal_values_share_one_output_and_larger_ones_are_never_darker(pair: tuple[Values, Values]) -> None:
    image, reference = as_images(*pair)
    aligned = tone_aligned(image, reference)[0]
    for c in range(3):
        order = np.argsort(image[0, :, c], kind="stable")
        steps, rises = np.diff(image[0, order, c]), np.diff(aligned[order, c])
        assert (rises >= 0).all()
        assert (rises[steps == 0] == 0).all()


def picture(seed: int, size: int = 40) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return gaussian_blur(rng.uniform(0.0, 1.0, (size, size, 3)), 1.0)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(
    power=st.tuples(*(st.floats(0.2, 5.0) for _ in range(3))),
    gain=st.tuples(*(st.floats(0.01, 50.0) for _ in range(3))),
    offset=st.floats(-3.0, 3.0),
)
def test_no_increasing_curve_per_channel_changes_the_result(
    power: tuple[float, ...], gain: tuple[float, ...], offset: float
) -> None:
    image, reference = picture(1), picture(1) + 0.1 * picture(2)
    changed = np.array(gain) * image ** np.array(power) + offset
    assert np.abs(tone_aligned(changed, reference) - tone_aligned(image, reference)).max() < 1e-7


@settings(derandomize=True, deadline=None, max_examples=25)
@given(noise=st.floats(0.0, 1.0), power=st.floats(0.3, 3.0))
def test_no_affine_alignment_of_positive_gain_comes_closer(noise: float, power: float) -> None:
    reference = picture(3)
    image = reference**power + noise * picture(4)
    curve = ((tone_aligned(image, reference).astype(np.float64) - reference) ** 2).mean((0, 1))
    for c in range(3):
        gain, offset = np.polyfit(image[..., c].ravel(), reference[..., c].ravel(), 1)
        assert gain > 0
        assert curve[c] <= ((gain * image[..., c] + offset - reference[..., c]) ** 2).mean() + 1e-9


def test_a_gamma_is_undone_where_gain_and_offset_cannot() -> None:
    reference = picture(6)
    image = reference**3
    assert psnr(tone_aligned(image, reference), reference) == 100.0
    assert psnr(affine_aligned(image, reference), reference) < 35


def test_noise_blur_shift_and_mixed_channels_stay_visible() -> None:
    reference = picture(7, 64)
    noise = np.random.default_rng(8).normal(0, 0.1, reference.shape)
    damaged = {
        "noise": reference + noise,
        "blur": gaussian_blur(reference, 2.0),
        "shift": np.roll(reference, 1, axis=1),
        "channels": reference[..., ::-1],
        "negative": 1 - reference,
    }
    for name, image in damaged.items():
        assert psnr(tone_aligned(image, reference), reference) < 30, name


def test_a_constant_channel_becomes_the_mean_of_the_reference() -> None:
    reference = picture(9)
    image = reference.copy()
    image[..., 1] = 0.4
    aligned = tone_aligned(image, reference)
    assert np.allclose(aligned[..., 1], reference[..., 1].mean(), atol=1e-6)
    assert np.allclose(aligned[..., [0, 2]], reference[..., [0, 2]], atol=1e-6)


def test_a_curve_fits_of_pure_noise_as_much_as_theory_says() -> None:
    # n values without order form N levels, N a sum of Bernoulli(1/k), and explain a chi-squared of N - 1 degrees.
    repeats, side = 40, 16
    k = np.arange(1, side**2 + 1)
    rng = np.random.default_rng(10)
    explained = []
    for _ in range(repeats):
        image, reference = rng.normal(0, 1, (2, side, side, 3))
        residual = ((tone_aligned(image, reference) - reference) ** 2).sum((0, 1))
        explained.append(((reference - reference.mean((0, 1))) ** 2).sum((0, 1)) - residual)
    variance = 2 * (1 / k[1:]).sum() + (1 / k - 1 / k**2).sum()
    error = np.sqrt(variance / (3 * repeats))
    assert np.mean(explained) == pytest.approx((1 / k[1:]).sum(), abs=5 * error)


def test_images_that_cannot_be_compared_are_refused() -> None:
    with pytest.raises(ValueError, match="of one size"):
        tone_aligned(picture(0, 8), picture(0, 9))
    with pytest.raises(ValueError, match="image must be finite"):
        tone_aligned(np.full((2, 2, 3), np.inf), np.zeros((2, 2, 3)))


def test_affine_alignment_is_the_line_of_least_squares_for_any_gain() -> None:
    """Against numpy's: of gains far below, above and of the other sign."""
    rng = np.random.default_rng(5)
    image = rng.uniform(0.3, 0.6, (9, 8, 3)).astype(np.float32)
    for gain in (0.2, 1.6, -0.7):
        reference = (0.45 + gain * (image - 0.45) + rng.normal(0, 0.01, image.shape)).astype(np.float32).clip(0, 1)
        found = affine_aligned(image, reference)
        for c in range(3):
            line = np.polyval(np.polyfit(image[..., c].ravel(), reference[..., c].ravel(), 1), image[..., c])
            np.testing.assert_allclose(found[..., c], line.clip(0, 1), atol=1e-5)
