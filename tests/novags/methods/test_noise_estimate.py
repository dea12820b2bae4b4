"""Claims about noise that the dark pictures tell themselves: near the camera's own, whatever became of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import integrate

from novags.methods import noise_estimate
from novags.methods.memo import Memo
from novags.methods.noise import Noise, camera_noise
from novags.methods.noise_estimate import (
    BINS,
    _before_8_bits,
    _binned,
    _measured,
    camera_figures,
    estimate_noise,
    noise_from,
    noise_of,
)
from novags.methods.problem import RawPictures
from novags.testbed.stages.capturing import expose_with_truth
from sensor_model import PRESETS, Exposure, develop, from_linear16
from sensor_model.mosaicking import channel_index
from sensor_model.params import CFAS, Cfa

EXPOSURE = Exposure(time=1 / 30)
SIZE, VIEWS = 112, 3
FAST = {("a7s2-iso6400", 2.0), ("imx900-hcg", 5.0), ("imx686-iso800", 20.0), ("a7s2-iso6400", 80.0)}


def lights() -> list[np.ndarray]:
    """Views of a made scene: shading over a range of 60, edges, and a textured fifth."""
    found = []
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    for k in range(VIEWS):
        base = np.exp(1.2 * np.sin(5 * x + k) + 0.9 * np.cos(4 * y - k))
        base = base * np.where((x + y * 0.5 + 0.1 * k) % 0.37 < 0.2, 1.0, 0.35)
        texture = 1 + 0.3 * np.sin(60 * x) * np.sin(50 * y) * (x > 0.8)
        found.append(np.stack([base * texture, 0.9 * base * texture, 0.7 * base * texture], -1).astype(np.float32))
    return found


def shot(name: str, electrons: float, **how: object) -> tuple[torch.Tensor, torch.Tensor, RawPictures, np.ndarray]:
    """8-bit pictures, linear ones, raw frames, and the mean of each pixel of those [n, 3] in linear light."""
    sensor, views = PRESETS[name], lights()
    mean = float(np.mean([view[..., 1].mean() for view in views]))
    pairs = [expose_with_truth(light, sensor, EXPOSURE, electrons=electrons, mean_green=mean, seed=0, view=i)
             for i, light in enumerate(views)]  # fmt: skip
    frames = [frame for frame, _ in pairs]
    developed = [develop(frame, sensor, **how) for frame in frames]  # type: ignore[arg-type]
    three = [frame.clean_dn if clean is None else clean for frame, clean in pairs]
    levels = (np.stack(three).astype(np.float64) - sensor.black_level) / (sensor.white_dn - sensor.black_level)
    raw = RawPictures(dn=torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32)), cfa=sensor.cfa,
                      black=sensor.black_level, white=sensor.white_dn)  # fmt: skip
    return (
        torch.from_numpy(np.stack([d.srgb8 for d in developed]) / np.float32(255)),
        torch.from_numpy(np.stack([from_linear16(d.linear16) for d in developed])),
        raw,
        (levels / np.asarray(sensor.rgb_response)).reshape(-1, 3),
    )


def decibels(found: Noise, name: str, clean: np.ndarray) -> float:
    """Error of the variance at the brightnesses of the pictures, root mean square."""
    known = camera_noise(PRESETS[name], EXPOSURE, demosaic="menon", color_matrix=None)
    at = torch.from_numpy(np.quantile(clean, np.linspace(0.02, 0.98, 25), axis=0))
    ratio = (found.linear16(at) / known.linear16(at)).clamp_min(1e-30).numpy()
    return float(np.sqrt((10 * np.log10(ratio)) ** 2).mean())


@pytest.mark.parametrize(
    ("camera", "electrons"),
    [
        pytest.param(camera, electrons, marks=[] if (camera, electrons) in FAST else [pytest.mark.slow])
        for camera in ("a7s2-iso6400", "imx900-hcg", "imx686-iso800", "d850-iso1600")
        for electrons in (2.0, 5.0, 20.0, 80.0)
    ],
)
def test_the_curve_is_within_a_decibel_of_the_cameras_own(camera: str, electrons: float) -> None:
    """Expectation: root mean square over the brightnesses; clipping and filters not seen to would cost 3 dB and more.

    Three chips by their linear and their 8-bit pictures, the mosaic by its measured values; gain and read noise of it
    are two ends of one line, so what one lacks the other has too much.
    """
    srgb8, linear, _, clean = shot(f"{camera}-3chip", electrons)
    assert decibels(estimate_noise(linear), f"{camera}-3chip", clean) < 0.5
    assert decibels(noise_from(srgb8, None, None, mixed=False), f"{camera}-3chip", clean) < 1.0
    srgb8, linear, raw, clean = shot(camera, electrons)
    found = noise_from(srgb8, linear, raw, mixed=False)
    assert decibels(found, camera, clean) < 0.7
    sensor = PRESETS[camera]
    known = camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=None)
    assert found.raw is not None
    assert known.raw is not None
    dn = sensor.black_level + sensor.gain * torch.tensor([[1.0] * 3, [electrons] * 3], dtype=torch.float64)
    assert (found.raw(dn) / known.raw(dn)).log10().abs().max() < 0.1  # 1 dB
    figures = camera_figures(raw)
    read = math.sqrt(known.raw.curve.offset[0] - 1 / 12) / sensor.gain
    assert figures.gain == pytest.approx(sensor.gain, rel=0.3 if electrons < 20 else 0.15)
    assert figures.read_noise == pytest.approx(read, rel=0.5 if electrons < 5 else 0.4)
    assert figures.black == sensor.black_level


def test_the_rounding_to_whole_codes_is_no_read_noise() -> None:
    """Half an electron of it at 0.8 DN an electron: with the variance of rounding it would seem to be 0.62."""
    rng, gain, read = np.random.default_rng(0), 0.8, 0.5
    mean = np.broadcast_to(np.geomspace(0.5, 60, 300), (6, 300, 300))  # electrons
    dn = np.round(100 + gain * (rng.poisson(mean) + read * rng.standard_normal(mean.shape)))
    raw = RawPictures(dn=torch.from_numpy(dn).float(), cfa=None, black=100.0, white=4095.0)
    figures = camera_figures(raw)
    assert figures.gain == pytest.approx(gain, rel=0.03)
    assert figures.read_noise == pytest.approx(read, abs=0.07)


@pytest.mark.parametrize("electrons", [2.0, 20.0])
def test_a_black_level_that_nobody_states_is_found_in_the_dark(electrons: float) -> None:
    """Expectation: from noise below it to the light of the darkest hundredth, 4 % of the mean, above it."""
    sensor = PRESETS["a7s2-iso6400"]
    raw = replace(shot("a7s2-iso6400", electrons)[2], black=0.0)
    figures = camera_figures(raw, black_known=False)
    off = (figures.black - sensor.black_level) / sensor.gain
    assert -0.4 < off < 0.06 * electrons + 0.2
    assert figures.read_noise == pytest.approx(1.18, rel=0.45)


@pytest.mark.parametrize(("demosaic", "least"), [("menon", 1.6), ("malvar", 4.0), ("bilinear", 6.5)])
def test_noise_that_neighbours_share_is_seen_as_such(demosaic: str, least: float) -> None:
    """Expectation: neighbours alone say far too little; farther pixels say what the green of the pictures has."""
    name = "a7s2-iso6400"
    _, linear, _, clean = shot(name, 5.0, demosaic=demosaic)
    known = camera_noise(PRESETS[name], EXPOSURE, demosaic="menon", color_matrix=None)
    at = torch.from_numpy(np.quantile(clean, [0.3, 0.5, 0.7], axis=0))
    near = _binned(linear[..., 1].double(), 1)
    blind = np.interp(at[:, 1], near[0], near[1])
    true = known.linear16(at)[:, 1].numpy()
    assert 10 * np.log10(true / blind).mean() > least
    found = estimate_noise(linear).linear16(at)[:, 1].numpy()
    assert np.abs(10 * np.log10(found / true)).mean() < 2.0
    assert 10 * np.log10(found / blind).mean() > least - 1.5


@pytest.mark.parametrize("channel", range(3))
def test_noise_that_neighbours_share_in_any_channel_is_measured_farther_apart_in_all(
    monkeypatch: pytest.MonkeyPatch, channel: int
) -> None:
    pictures = torch.rand(1, 32, 32, 3, generator=torch.Generator().manual_seed(0))
    reaches = iter(3 if c == channel else 1 for c in range(3))
    monkeypatch.setattr(noise_estimate, "_reach", lambda plane, eight_bit: next(reaches))
    taken, binned = [], noise_estimate._binned
    monkeypatch.setattr(noise_estimate, "_binned", lambda part, reach: taken.append(reach) or binned(part, reach))
    estimate_noise(pictures)
    assert taken == [3, 3, 3]


@pytest.mark.parametrize(("ratios", "reach"), [([1.3] * 7 + [4.5], 1), ([1.7] * 8, 2), ([3.2] * 8, 3)])
def test_one_range_with_texture_does_not_make_noise_shared(
    monkeypatch: pytest.MonkeyPatch, ratios: list[float], reach: int
) -> None:
    """The mean of the first ratios is 1.70, above the limit of 1.6; their geometric one is 1.52."""
    mean, near = torch.linspace(0.1, 0.9, BINS), torch.full((BINS,), 1e-6)
    far = near * torch.tensor(ratios + [50.0] * (BINS - 8))  # the brighter half has no say
    monkeypatch.setattr(noise_estimate, "_binned", lambda plane, distance: (mean, near if distance == 1 else far))
    assert noise_estimate._reach(torch.zeros(1, 16, 16), False) == reach


def test_ranges_that_8_bits_clip_at_black_have_no_say_in_whether_noise_is_shared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Below two standard deviations a picture of 8 bits has lost half of its noise."""
    mean, near = torch.linspace(1e-3, 0.9, BINS), torch.full((BINS,), 1e-6)
    mean[:5], far = 1e-3, near * torch.tensor([9.0] * 5 + [1.2] * (BINS - 5))
    monkeypatch.setattr(noise_estimate, "_binned", lambda plane, distance: (mean, near if distance == 1 else far))
    assert [noise_estimate._reach(torch.zeros(1, 16, 16), eight_bit) for eight_bit in (True, False)] == [1, 3]


def test_bins_have_the_mean_and_the_variance_of_plain_loops() -> None:
    """Expectation: of each pixel the 5 x 5 mean, the gradient of that, and a second difference over `reach` pixels.

    Of neighbours the 3 x 3 mean counts, and pixels are sorted by the others of the 25.
    """
    rng = np.random.default_rng(1)
    picture = np.linspace(0, 1, 30)[:, None] * np.linspace(0.2, 1, 32) + rng.normal(0, 0.01, (30, 32))
    for reach in (1, 2, 3):
        rows = []
        mean = {(y, x): picture[y - 2 : y + 3, x - 2 : x + 3].mean() for y in range(2, 28) for x in range(2, 30)}
        for y in range(3, 27):
            for x in range(3, 29):
                second = sum(
                    (-2.0 if dy == 0 else 1.0) * (-2.0 if dx == 0 else 1.0) * picture[y + reach * dy, x + reach * dx]
                    for dy in (-1, 0, 1)
                    for dx in (-1, 0, 1)
                )
                steep = (mean[y, x + 1] - mean[y, x - 1]) ** 2 + (mean[y + 1, x] - mean[y - 1, x]) ** 2
                inner = picture[y - 1 : y + 2, x - 1 : x + 2].mean()
                key = (25 * mean[y, x] - 9 * inner) / 16 if reach == 1 else mean[y, x]
                rows.append((inner if reach == 1 else mean[y, x], steep, second**2 / 36, key))
        rows.sort(key=lambda row: row[3])
        found_mean, found_variance = _binned(torch.from_numpy(picture)[None], reach)
        for k, part in enumerate(np.array_split(np.array(rows), 16)):
            flat = part[part[:, 1].argsort()[: max(8, int(0.3 * len(part)))]]
            assert float(found_mean[k]) == pytest.approx(flat[:, 0].mean(), rel=1e-9)
            limit = np.median(flat[:, 2]) if len(flat) % 2 else np.sort(flat[:, 2])[(len(flat) - 1) // 2]
            limit /= 0.45494
            for _ in range(4):
                limit = flat[flat[:, 2] <= 16 * limit, 2].mean() / 0.99887
            assert float(found_variance[k]) == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize("cfa", CFAS)
def test_pixels_behind_filters_of_one_colour_are_pictures_of_their_own(cfa: Cfa) -> None:
    """Of two views of odd size; every value says where it lies. The last row and column have no cell."""
    plane, channel = torch.arange(2.0 * 7 * 9).reshape(2, 7, 9), channel_index((7, 9), cfa)
    for c, letter in enumerate("RGB"):
        found = _measured(plane, cfa, letter)
        assert found.shape == (2 * cfa.count(letter), 3, 4)
        want = plane[:, :6, :8][:, torch.from_numpy(channel[:6, :8] == c)]
        assert sorted(found.flatten().tolist()) == sorted(want.flatten().tolist())
        assert bool((found.diff(dim=1) == 18).all())
        assert bool((found.diff(dim=2) == 2).all())


@pytest.mark.parametrize("z", [-0.5, 0.0, 1.0, 4.0])
def test_clipping_at_black_and_rounding_to_codes_are_undone(z: float) -> None:
    """Expectation: the moments by numerical integration, rounding by its variance at the slope of the sRGB curve."""
    sigma = 0.002
    density = lambda t: math.exp(-0.5 * t * t) / math.sqrt(2 * math.pi)  # noqa: E731
    first, second = (
        integrate.quad(lambda t, power=power: (z + t) ** power * density(t), -z, 12, epsabs=1e-13)[0]
        for power in (1, 2)
    )
    mean, variance = sigma * first, sigma**2 * (second - first**2)
    code = 12.92 * mean if mean <= 0.0031308 else 1.055 * mean ** (1 / 2.4) - 0.055
    step = 1 / 255 / ((12.92 * (mean + 1e-7) - 12.92 * mean) / 1e-7 if mean <= 0.0031308 else
                      (1.055 * (mean + 1e-7) ** (1 / 2.4) - 0.055 - code) / 1e-7)  # fmt: skip
    found = _before_8_bits(*(torch.tensor([v, v], dtype=torch.float64) for v in (mean, variance + step**2 / 12)))
    assert float(found[0][0]) == pytest.approx(z * sigma, abs=2e-4 * sigma)
    assert float(found[1][0]) == pytest.approx(sigma**2, rel=1e-3)


def test_views_of_one_camera_are_measured_together() -> None:
    """Rationale: a dark view and a bright one each know one end of the line."""
    rng = np.random.default_rng(0)
    mean = np.stack([np.full((64, 64, 3), 0.01), np.full((64, 64, 3), 0.4)])
    mean = mean * np.linspace(0.8, 1.2, 64)[None, None, :, None]
    linear = torch.from_numpy(mean + rng.normal(0, np.sqrt(1e-5 + 1e-3 * mean)))
    curve = estimate_noise(linear).linear16.curve
    np.testing.assert_allclose(curve.offset, 1e-5, rtol=0.35)
    np.testing.assert_allclose(curve.slope, 1e-3, rtol=0.2)


def test_the_curve_of_raw_frames_begins_at_their_black_and_ends_at_their_white() -> None:
    """Two electrons a code over a black of 100 DN; the three colours of a mosaic share one amplifier."""
    rng = np.random.default_rng(0)
    light = np.broadcast_to(np.linspace(20, 900, 240)[None, None, :], (2, 240, 240))
    dn = 100 + 0.5 * rng.poisson(2 * light) + rng.normal(0, 2, light.shape)
    raw = RawPictures(dn=torch.from_numpy(dn.astype(np.float32)), cfa="RGGB", black=100.0, white=1100.0)
    curve = noise_estimate.estimate_raw_noise(raw)
    assert (curve.black, curve.white) == ((100.0,) * 3, (1100.0,) * 3)
    np.testing.assert_allclose(curve.slope, 0.5, rtol=0.15)
    np.testing.assert_allclose(curve.variance(np.full(3, 500.0)), 4 + 0.5 * 400, rtol=0.1)


def test_a_problem_says_which_noise_it_has_and_what_its_pictures_say(problem) -> None:
    base = problem(sigma=0.01)
    grown = replace(base, views=base.views, shared=Memo())
    known = camera_noise(PRESETS["ideal"], EXPOSURE, demosaic="menon", color_matrix=None)
    informed = replace(grown, noise=known)
    assert noise_of(informed) is known
    told = noise_of(informed, "pictures")
    assert (told.origin, known.origin) == ("pictures", "camera")
    assert noise_of(informed, "pictures") is told  # once for all methods
    others = replace(informed, names=tuple(f"other {name}" for name in informed.names), srgb8=informed.srgb8 / 2)
    assert noise_of(others, "pictures").linear16.curve != told.linear16.curve
    assert noise_of(grown).origin == "pictures"  # where no camera is known
    with pytest.raises(ValueError, match="source must be camera or pictures, got 'truth'"):
        noise_of(informed, "truth")  # type: ignore[arg-type]
