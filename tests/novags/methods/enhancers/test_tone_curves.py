"""Tone curves against their equations written out pixel by pixel, and their parameters on another exposure."""

import math

import numpy as np
import pytest
import torch

from novags.methods import METHODS, chosen
from novags.methods.enhancers import ENHANCERS, enhancement_record, recorded
from novags.methods.enhancers.applying import enhanced_like
from novags.methods.enhancers.curves.curve import geometric_mean_params
from novags.methods.enhancers.curves.equalise import mean_curve
from novags.methods.enhancers.rows.adaptive import Ap3Config, AseConfig
from novags.methods.enhancers.rows.drago import DragoConfig
from novags.methods.enhancers.rows.equalise import EqualiseConfig
from novags.methods.enhancers.rows.gain import GainConfig
from novags.methods.enhancers.rows.gamma import GammaConfig
from novags.methods.enhancers.rows.naka import NakaConfig
from novags.testbed.ledger.contents import jsonable

CURVES = [
    GammaConfig(), GammaConfig(gamma=None), GainConfig(), DragoConfig(), EqualiseConfig(), AseConfig(), Ap3Config(),
    NakaConfig(),
]  # fmt: skip
Y = (0.2126, 0.7152, 0.0722)


def picture(seed: int = 0, scale: float = 0.2) -> np.ndarray:
    """Dark, with a bright spot and a black pixel."""
    rng = np.random.default_rng(seed)
    image = scale * rng.uniform(0.05, 1, (7, 9, 3)) * (1, 0.7, 0.4)
    image[2, 3], image[4, 4] = (0.9, 0.8, 0.3), 0.0
    return image


def decode(code: float) -> float:
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


def encode(light: float) -> float:
    light = min(light, 1.0)
    return 12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055


def luminance(rgb) -> float:
    return sum(w * v for w, v in zip(Y, rgb, strict=True))


def run(config, dark: np.ndarray, params=None):
    enhancer = next(e for e in ENHANCERS.values() if isinstance(config, e.config))
    found, params = enhancer.enhance(torch.from_numpy(dark), config, params, None)
    return found.numpy(), params


def test_gamma_is_a_power_of_the_codes():
    dark = picture()
    np.testing.assert_allclose(run(GammaConfig(), dark)[0], dark**0.2, rtol=1e-12)


def test_automatic_gamma_and_gain_bring_the_mean_code_to_the_target():
    dark = picture()
    for config in (GammaConfig(gamma=None), GammaConfig(gamma=None, target=0.3), GainConfig(), GainConfig(target=0.3)):
        assert run(config, dark)[0].mean() == pytest.approx(config.target, abs=1e-9)


def test_gain_multiplies_the_light_and_clips_at_white():
    dark = picture()
    found, params = run(GainConfig(), dark)
    wanted = [encode(float(params[0]) * decode(v)) for v in dark.ravel()]
    np.testing.assert_allclose(found.ravel(), wanted, rtol=1e-9)
    assert found.max() == pytest.approx(1)


def test_drago_is_the_published_equation():
    dark = picture()
    found, _ = run(DragoConfig(bias=0.8), dark)
    light = [[decode(v) for v in pixel] for pixel in dark.reshape(-1, 3)]
    top = max(map(luminance, light))
    average = math.exp(sum(math.log(max(luminance(p), 1e-4 * top)) for p in light) / len(light))
    wanted = []
    for pixel in light:
        x, most = luminance(pixel) / average, top / average
        bias = (x / most) ** (math.log(0.8) / math.log(0.5))
        shown = math.log(x + 1) / math.log(2 + 8 * bias) / math.log10(most + 1)
        wanted.append([encode(v * shown / luminance(pixel)) if x > 0 else 0.0 for v in pixel])
    np.testing.assert_allclose(found.reshape(-1, 3), wanted, rtol=1e-9)
    brightest = np.argmax([luminance(p) for p in light])
    shown = [decode(v) for v in found.reshape(-1, 3)[brightest]]
    assert max(shown) == pytest.approx(1)  # the brightest luminance is white; its strongest channel is clipped there


def quantile(values: list[float], share: float) -> float:
    """Linear between the two nearest, as numpy's default."""
    ordered, place = sorted(values), share * (len(values) - 1)
    low = math.floor(place)
    high = min(low + 1, len(values) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


def adaptive_by_hand(dark: np.ndarray, curve: str, c: float, exponent: float = 2.5) -> list[float]:
    lumas = [0.299 * r + 0.587 * g + 0.114 * b for r, g, b in dark.reshape(-1, 3)]
    p90, p10, mean = quantile(lumas, 0.9), quantile(lumas, 0.1), sum(lumas) / len(lumas)
    offset, shown = 0.12 * (1 - p10 / p90) ** exponent, []
    for x in dark.ravel():
        t = x / p90
        if curve == "ase":
            shown.append(offset + (1 - offset) * (1 - math.exp(-(0.9 + c * mean) * t)))
        else:
            shown.append(min(offset + (1 + c * mean) * (0.0720 * t**3 - 0.4376 * t**2 + 0.9948 * t), 1.0))
    return shown


def test_adaptive_curves_are_the_published_equations():
    dark = picture()
    for config, wanted in (
        (AseConfig(), adaptive_by_hand(dark, "ase", 4)),
        (AseConfig(gain=3.0, exponent=1.5), adaptive_by_hand(dark, "ase", 3, 1.5)),
        (Ap3Config(), adaptive_by_hand(dark, "ap3", 2)),
        (Ap3Config(gain=0.0), adaptive_by_hand(dark, "ap3", 0)),
    ):
        np.testing.assert_allclose(run(config, dark)[0].ravel(), wanted, rtol=1e-9)


def test_naka_is_the_response_between_its_ends():
    dark = 0.9 * picture() + 0.02  # nothing is black: both ends are the picture's own
    response = [x / (x + 0.05) for x in dark.ravel()]
    low, high = min(response), max(response)
    np.testing.assert_allclose(run(NakaConfig(), dark)[0].ravel(), [(y - low) / (high - low) for y in response])


@pytest.mark.parametrize("config", [AseConfig(), Ap3Config(), NakaConfig()], ids=repr)
def test_what_has_no_contrast_stays_as_it_is(config):
    black = np.zeros((5, 6, 3))
    np.testing.assert_array_equal(run(config, black)[0], black)


@pytest.mark.parametrize("make", [AseConfig, Ap3Config])
def test_a_scene_gets_one_curve_of_the_mean_statistics_of_its_pictures(make):
    pictures = [torch.from_numpy(picture(i, 0.1 * (i + 1))) for i in range(3)]
    enhancer = next(e for e in ENHANCERS.values() if e.config is make)
    assert enhancer.settled is not None
    config = enhancer.settled(pictures, make(scene_wide=True))
    stats = [run(make(), one.numpy())[1] for one in pictures]
    np.testing.assert_allclose(config.statistics, np.mean(stats, axis=0))
    np.testing.assert_array_equal(run(config, picture(9))[1], config.statistics)  # of any picture, of this scene
    assert enhancer.settled(pictures, make()) == make()
    assert enhancer.settled(pictures, config) is config
    with pytest.raises(ValueError, match="scene_wide takes statistics of all pictures"):
        run(make(scene_wide=True), picture())


def test_equalisation_gives_each_luma_the_share_of_pixels_below_it():
    dark = picture()
    dark[0] = dark[1]  # some lumas occur twice
    found, _ = run(EqualiseConfig(), dark)
    lumas = [luminance(p) for p in dark.reshape(-1, 3)]
    least = sum(v == min(lumas) for v in lumas)
    for pixel, luma, bright in zip(dark.reshape(-1, 3), lumas, found.reshape(-1, 3), strict=True):
        share = (sum(v <= luma + 1e-15 for v in lumas) - least) / (len(lumas) - least)
        ratio = share / luma if luma > 0 else 0.0
        np.testing.assert_allclose(bright, np.minimum(pixel * ratio, 1), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("config", CURVES, ids=repr)
def test_the_parameters_of_a_picture_bring_its_twin_through_the_same_curve(config):
    """Rationale: a reference that chose a curve of its own would differ from the picture by more than noise."""
    dark, twin = picture(), picture(1, 0.15)
    found, params = run(config, dark)
    np.testing.assert_array_equal(run(config, dark, params)[0], found)
    mixed = dark.copy()
    mixed[5:], mixed[6, 8] = twin[5:], 1.0  # brighter than any pixel, which some curves go by
    np.testing.assert_array_equal(run(config, mixed, params)[0][:5], found[:5])
    if config != GammaConfig():
        assert np.abs(run(config, mixed)[0][:5] - found[:5]).max() > 1e-3


@pytest.mark.parametrize("config", CURVES, ids=repr)
def test_a_brighter_pixel_stays_the_brighter_one(config):
    ramp = np.repeat(np.linspace(0, 0.4, 64)[:, None, None], 3, 2)
    found, _ = run(config, ramp)
    assert (np.diff(found[:, 0, 1]) >= -1e-12).all()
    assert found.mean() > ramp.mean()


@pytest.mark.parametrize("config", CURVES, ids=repr)
def test_typical_parameters_lie_between_those_they_are_of(config):
    enhancer = next(e for e in ENHANCERS.values() if isinstance(config, e.config))
    params = [run(config, picture(i, 0.1 * (i + 1)))[1] for i in range(3)]
    dark = torch.from_numpy(picture(7))
    shown = [enhanced_like(dark, config, each) for each in params]
    middle = enhanced_like(dark, config, enhancer.typical(params))
    low, high = (bound([s.numpy() for s in shown], axis=0) for bound in (np.min, np.max))
    assert ((middle.numpy() >= low - 1e-9) & (middle.numpy() <= high + 1e-9)).all()


def test_the_typical_equalisation_is_the_mean_of_the_curves_at_every_luma_of_any() -> None:
    first, second = np.array([[0.0, 0.4, 1.0], [0.0, 0.8, 1.0]]), np.array([[0.0, 0.5, 1.0], [0.2, 0.4, 0.6]])
    lumas, shares = mean_curve([first, second])
    np.testing.assert_allclose(lumas, [0, 0.4, 0.5, 1])
    np.testing.assert_allclose(shares, [0.1, (0.8 + 0.36) / 2, (0.8 + 0.2 / 6 + 0.4) / 2, 0.8])


def test_typical_factors_are_geometric_means_of_the_pictures_with_light():
    params = [np.array([1.0, 4.0]), np.zeros(2), np.array([100.0, 9.0])]
    np.testing.assert_allclose(geometric_mean_params(params), [10, 6])


@pytest.mark.parametrize("config", CURVES, ids=repr)
def test_a_record_brings_the_curve_back(config):
    enhancer, found = recorded(jsonable(enhancement_record(config, "8bit")))
    assert found == config
    assert isinstance(config, enhancer.config)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GammaConfig(gamma=0.0), "gamma must be > 0"),
        (lambda: GammaConfig(gamma=math.nan), "gamma must be > 0"),
        (lambda: GainConfig(target=1.0), "target must lie in"),
        (lambda: DragoConfig(bias=1.0), "bias must lie in"),
        (lambda: AseConfig(gain=-1.0), "gain must be >= 0"),
        (lambda: AseConfig(slope=0.0), "slope must be > 0"),
        (lambda: Ap3Config(offset=1.0), "offset must lie in"),
        (lambda: Ap3Config(statistics=(0.1, 0.2, 0.1)), "p10 <= p90"),
        (lambda: NakaConfig(half=0.0), "half must be > 0"),
    ],
)
def test_settings_out_of_range_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_every_curve_is_a_method_that_differs_from_naive_in_its_enhancement_alone():
    """Rationale: a fair fight; cameras, iterations, cap and loss are those of naive."""
    naive = METHODS["naive"].config()
    for name in ("gamma-gs", "gain-gs", "drago-gs", "equalise-gs", "gamma-auto-gs", "ase-gs", "ap3-gs", "naka-gs"):
        variant = chosen(name)
        method = METHODS[variant.method]
        config = variant.config(method.config(), {})
        assert (config.fit, config.init_scale, config.pictures) == (naive.fit, naive.init_scale, naive.pictures)
        assert (method.train, method.sees_clean) == (METHODS["naive"].train, False)
        assert config.enhance in CURVES


def test_pictures_out_of_range_are_refused():
    with pytest.raises(ValueError, match="in 0..1"):
        run(GammaConfig(), picture() - 0.1)
