"""The loss of stage 1 and its data, against slow versions written anew."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.inputs import LacksInput
from novags.methods.noise import Variance, camera_noise
from novags.methods.nova_plus.data import FULL, LightMeasurements, exposures
from novags.methods.nova_plus.likelihood import FLOOR, Likelihood
from novags.methods.problem import Problem, RawPictures
from novags.methods.tone import ToneCurve
from novags.splats.views import Views
from sensor_model import PRESETS, DualGain, Exposure, develop_linear, expose, linear_noise, mosaic
from sensor_model.isp import white_balance
from sensor_model.noise import Bend

CURVE = ToneCurve(top=0.2, k=4.0)
SIDE = 12
MATRIX = [[1.6, -0.5, -0.1], [-0.2, 1.4, -0.2], [0.0, -0.6, 1.6]]


def problem_of(sensor: Any, seed: int = 0, **more: Any) -> tuple[Problem, np.ndarray]:
    """Two views of a camera, and their true photons [2, SIDE, SIDE, 3]."""
    photons = np.random.default_rng(5).uniform(2, 60, (2, SIDE, SIDE, 3)).astype(np.float32)
    exposure = Exposure(time=1 / 30)
    frames = [
        expose(mosaic(p, sensor.cfa) if sensor.cfa else p, sensor, exposure, seed=seed, view=i).dn
        for i, p in enumerate(photons)
    ]
    dn = torch.from_numpy(np.stack(frames).astype(np.float32))
    views = Views(torch.eye(4).repeat(2, 1, 1), torch.eye(3).repeat(2, 1, 1), SIDE, SIDE)
    red, green, blue = white_balance(sensor).tolist()
    raw = RawPictures(
        dn=dn, cfa=sensor.cfa, black=float(sensor.black_level), white=sensor.white_dn, balance=(red, green, blue)
    )
    start: Any = SimpleNamespace(points=torch.zeros(2, 3), colors=torch.zeros(2, 3), extent=1.0)
    noise = camera_noise(sensor, exposure, demosaic="bilinear", color_matrix=None)
    blank = torch.zeros(2, SIDE, SIDE, 3)
    problem = Problem(views=views, start=start, seed=seed, srgb8=blank, raw=raw, noise=noise, **more)
    return problem, photons


def test_three_chips_give_the_light_of_the_linear_picture() -> None:
    sensor = PRESETS["a7s2-iso6400-3chip"]
    problem, _ = problem_of(sensor)
    assert problem.raw is not None
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.0)
    for view, dn in zip(data.light.numpy(), problem.raw.dn.numpy(), strict=True):
        np.testing.assert_allclose(view, develop_linear(dn, sensor), rtol=1e-5, atol=1e-6)
    assert bool(data.measured.all())
    assert not bool(data.held.any())


def test_behind_a_filter_array_a_pixel_measures_the_channel_of_its_filter_alone() -> None:
    sensor = PRESETS["a7s2-iso6400"]
    assert sensor.cfa == "RGGB"
    problem, _ = problem_of(sensor)
    assert problem.raw is not None
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.0)
    want = torch.zeros(SIDE, SIDE, 3, dtype=torch.bool)
    want[::2, ::2, 0] = want[1::2, ::2, 1] = want[::2, 1::2, 1] = want[1::2, 1::2, 2] = True
    assert torch.equal(data.measured[0], want)
    assert torch.equal(data.measured[1], want)
    balance = white_balance(sensor)
    dn = float(problem.raw.dn[1, 1, 1])  # blue
    want_light = balance[2] * (dn - sensor.black_level) / (sensor.white_dn - sensor.black_level)
    assert float(data.light[1, 1, 1, 2]) == pytest.approx(want_light, rel=1e-5)


@pytest.mark.parametrize("name", ["a7s2-iso6400-3chip", "a7s2-iso6400"])
def test_the_variance_is_that_of_the_light_over_many_exposures(name: str) -> None:
    sensor = replace(PRESETS[name], dsnu=0.0, prnu=0.0)
    _, photons = problem_of(sensor)
    found = []
    for seed in range(300):
        problem, _ = problem_of(sensor, seed=seed)
        assert problem.noise is not None
        found.append(exposures(problem, problem.noise, 0.0).light[0])
    stack = torch.stack(found).double()
    mean, variance = stack.mean(0), stack.var(0)
    claimed = exposures(problem, problem.noise, 0.0).noise(mean.nan_to_num())
    there = ~mean.isnan()
    for c in range(3):
        ratio = (variance[..., c][there[..., c]] / claimed[..., c][there[..., c]]).mean()
        assert abs(float(ratio) - 1) < 5 * math.sqrt(2 / 300 / int(there[..., c].sum())) + 0.02, c


def test_two_gains_switch_at_the_same_datum_in_light_as_in_raw_frames() -> None:
    gains = DualGain(threshold=500.0, sigma_d=9.0, ratio=8.0)
    sensor = replace(PRESETS["a7s2-iso6400-3chip"], dual_gain=gains)
    problem, _ = problem_of(sensor)
    assert problem.raw is not None
    assert problem.noise is not None
    assert problem.noise.raw is not None
    found = exposures(problem, problem.noise, 0.0).noise
    dn = sensor.black_level + sensor.gain * torch.linspace(100, 900, 80, dtype=torch.float64)[:, None].expand(-1, 3)
    unit = (sensor.white_dn - sensor.black_level) / torch.tensor(problem.raw.balance, dtype=torch.float64)
    want = problem.noise.raw(dn) / unit**2
    torch.testing.assert_close(found((dn - sensor.black_level) / unit), want, rtol=1e-5, atol=0)
    rise = want.diff(dim=0)
    assert bool((rise.amax(0) > 5 * rise[0]).all())  # both gains are there


def test_the_held_out_share_is_drawn_by_the_seed_and_no_fit_sees_it() -> None:
    problem, _ = problem_of(PRESETS["a7s2-iso6400-3chip"])
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.25)
    many = exposures(problem, problem.noise, 0.5).held
    assert float(many.float().mean()) == pytest.approx(0.5, abs=5 * 0.5 / math.sqrt(many.numel()))
    assert torch.equal(data.fitted.isnan(), data.held[..., None].expand_as(data.light))
    assert torch.equal(data.held, exposures(problem, problem.noise, 0.25).held)
    other, _ = problem_of(PRESETS["a7s2-iso6400-3chip"], seed=1)
    assert not torch.equal(data.held, exposures(other, problem.noise, 0.25).held)


def test_a_capture_without_raw_and_linear_pictures_is_refused() -> None:
    problem, _ = problem_of(PRESETS["a7s2-iso6400-3chip"])
    assert problem.noise is not None
    with pytest.raises(LacksInput, match="needs raw frames or 16-bit linear pictures"):
        exposures(replace(problem, raw=None), problem.noise, 0.0)
    assert problem.raw is not None
    unbalanced = replace(problem, raw=replace(problem.raw, balance=None))
    with pytest.raises(LacksInput, match="its raw frames have no known white balance or noise"):
        exposures(unbalanced, problem.noise, 0.0)


def test_raw_frames_of_another_size_than_the_pictures_are_left_alone() -> None:
    """As of a mosaic whose cells became pixels: cameras and renders have the size of the pictures."""
    problem, _ = problem_of(PRESETS["a7s2-iso6400"])
    half = torch.rand(2, SIDE // 2, SIDE // 2, 3, generator=torch.Generator().manual_seed(0))
    views = replace(problem.views, width=SIDE // 2, height=SIDE // 2)
    problem = replace(problem, views=views, srgb8=half, linear16=half)
    assert problem.noise is not None
    assert torch.equal(exposures(problem, problem.noise, 0.0).light, half)


def test_noise_that_data_share_is_named_and_raw_frames_share_none() -> None:
    problem, _ = problem_of(PRESETS["a7s2-iso6400"])
    assert problem.noise is not None
    problem = replace(problem, linear16=torch.zeros(2, SIDE, SIDE, 3), channels_share=("JPEG",))
    found = [exposures(p, problem.noise, 0.0).shared for p in
             (problem, replace(problem, raw=None), replace(problem, raw=None, channels_share=()))]  # fmt: skip
    assert found == [(), ("JPEG",), ("demosaicing",)]
    resampled = exposures(replace(problem, raw=None, pixels_share=("resampling",)), problem.noise, 0.5)
    assert resampled.shared == ("JPEG", "resampling")
    assert not bool(resampled.held.any())


def test_after_a_colour_matrix_the_variance_of_grey_light_is_that_of_its_channels_mixed() -> None:
    sensor, matrix = replace(PRESETS["a7s2-iso6400-3chip"], prnu=0.0), np.array(MATRIX)
    problem, _ = problem_of(sensor)
    noise = camera_noise(sensor, Exposure(time=1 / 30), demosaic="menon", color_matrix=MATRIX)
    pictures = torch.rand(2, SIDE, SIDE, 3, generator=torch.Generator().manual_seed(0))
    data = exposures(replace(problem, raw=None, linear16=pictures), noise, 0.0)
    before = linear_noise(sensor, Exposure(time=1 / 30), demosaic="menon", color_matrix=None)
    for grey in (0.0, 0.05, 0.2, 0.45):
        camera = before.variance(np.full((1, 3), grey) + before.black)[0]
        found = data.noise(torch.full((1, 3), grey).double())[0].numpy()
        for c in range(3):
            mixed = sum(matrix[c, k] ** 2 * camera[k] for k in range(3))
            assert found[c] == pytest.approx(mixed, rel=1e-4)


def slow_loss(tones: np.ndarray, light: np.ndarray, curve: ToneCurve, variance: Variance, white: float) -> float:
    """The equation of the module, one datum after another, in float64."""
    total, count = 0.0, 0
    for (i, j, c), y in np.ndenumerate(light):
        if math.isnan(y):
            continue
        count += 1
        r = float(tones[i, j, c])
        mu = curve.top * math.expm1(curve.k * r) / math.expm1(curve.k)
        g = curve.top * curve.k * math.exp(curve.k * r) / math.expm1(curve.k)
        if y >= FULL * white and mu > y:
            continue
        three = torch.full((3,), mu, dtype=torch.float64)
        n = float(variance(three)[c]) / g**2
        total += FLOOR / (n + FLOOR) * ((y - mu) / g) ** 2
    return total / count


def some_data() -> tuple[LightMeasurements, torch.Tensor, torch.Tensor]:
    problem, _ = problem_of(PRESETS["a7s2-iso6400"])
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.1)
    light = data.light.clone()
    light[:, 3, 3] = torch.where(light[:, 3, 3].isnan(), torch.nan, 3.0)  # saturated
    data = replace(data, light=light, white=torch.full((3,), 2.5))
    generator = torch.Generator().manual_seed(3)
    tones = torch.rand(2, SIDE, SIDE, 3, generator=generator) * 1.2 - 0.1
    tones[:, 3, 3] = 2.0  # brighter than what the sensor can say
    return data, data.fitted, tones


BEND = Bend(factor=(0.05, 0.06, 0.07), offset=(1e-5, 2e-5, 3e-5))


@pytest.mark.parametrize(
    ("dual", "black", "bend"), [(False, 0.0, None), (True, 0.0, None), (True, 0.02, None), (True, 0.02, BEND)]
)
def test_the_loss_follows_its_equation_on_what_there_is(dual: bool, black: float, bend: Bend | None) -> None:
    data, fitted, tones = some_data()
    if dual:  # a camera that reads bright pixels at a lower gain, with more noise
        curve = replace(
            data.noise.curve, black=(black,) * 3, switch=(0.02, 0.03, 0.04), step=(1e-4, 2e-4, 3e-4), bend=bend
        )
        data = replace(data, noise=Variance(curve))
    loss = Likelihood(data, CURVE)
    # the loss is a mean over all data of an average picture: of both together it is that of the data
    both = np.mean([float(loss.compare(t.numpy(), f.numpy())[0]) for t, f in zip(tones, fitted, strict=True)])
    want = slow_loss(
        tones.numpy().reshape(-1, SIDE, 3), fitted.numpy().reshape(-1, SIDE, 3), CURVE, data.noise, 2.5
    )  # fmt: skip
    assert both == pytest.approx(want, rel=1e-5)


def test_the_gradient_is_that_of_the_squares_with_weight_and_slope_held() -> None:
    data, fitted, tones = some_data()
    loss = Likelihood(data, CURVE)
    _, found = loss.compare(tones[0].numpy(), fitted[0].numpy())
    r0 = tones[0].double()
    slope = CURVE.slope(r0)
    weight = FLOOR / (data.noise(CURVE.light(r0)) / slope.square() + FLOOR)

    def held(r: torch.Tensor) -> torch.Tensor:
        near = CURVE.light(r0) + slope * (r - r0)
        gone = fitted[0].isnan() | ((fitted[0] >= FULL * 2.5) & (CURVE.light(r0) > fitted[0]))
        squares = torch.where(gone, 0.0, weight * ((fitted[0].nan_to_num() - near) / slope).square())
        return squares.sum() / (~fitted.isnan()).double().mean() / r0.numel()

    variable = r0.clone().requires_grad_()
    held(variable).backward()
    assert variable.grad is not None
    torch.testing.assert_close(torch.from_numpy(found).double(), variable.grad, rtol=1e-4, atol=1e-9)


def test_autograd_and_the_kernel_agree() -> None:
    data, fitted, tones = some_data()
    loss = Likelihood(data, CURVE)
    for device_type in ("cpu", "elsewhere"):
        render = tones[1].clone().requires_grad_()
        step: Any = SimpleNamespace(render=render)
        if device_type == "elsewhere":  # what a GPU would run, in float64
            render = tones[1].double().requires_grad_()
            step = SimpleNamespace(render=_Elsewhere(render))
        value = loss(step, fitted[1])
        value.backward()
        want, v_image = loss.compare(tones[1].numpy(), fitted[1].numpy())
        assert float(value.detach()) == pytest.approx(float(want), rel=1e-5)
        assert render.grad is not None
        torch.testing.assert_close(render.grad.float(), torch.from_numpy(v_image), rtol=1e-4, atol=1e-9)


class _Elsewhere:
    """A tensor that says it is on another device."""

    device = SimpleNamespace(type="cuda")

    def __init__(self, tensor: torch.Tensor) -> None:
        self.tensor = tensor

    def detach(self) -> torch.Tensor:
        return self.tensor.detach()

    def __sub__(self, other: torch.Tensor) -> torch.Tensor:
        return self.tensor - other


def test_noise_weighs_less_where_it_is_larger() -> None:
    """Where the noise variance equals FLOOR, an error in tone has half its weight; without noise, nearly all of it."""
    problem, _ = problem_of(PRESETS["a7s2-iso6400-3chip"])
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.0)
    r = torch.full((SIDE, SIDE, 3), 0.5)
    curve = data.noise.curve
    at_half = float(CURVE.slope(torch.tensor(0.5))) ** 2 * FLOOR
    zero, never = (0.0,) * 3, (math.inf,) * 3
    for offset, share in ((0.0, 1.0), (at_half, 0.5), (3 * at_half, 0.25)):
        even = replace(curve, offset=(offset,) * 3, slope=zero, quadratic=zero, switch=never, step=zero)
        loss = Likelihood(replace(data, noise=Variance(even)), CURVE)
        light = CURVE.light(r) + 0.1 * CURVE.slope(r)
        assert float(loss.compare(r.numpy(), light.numpy())[0]) == pytest.approx(share * 0.01, rel=1e-3)
