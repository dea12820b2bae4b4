"""Hard cases of what moves Gaussians: activations, Adam, relocation and noise of 3DGS-MCMC.

"torch" are the formulas that run on a GPU, here on the CPU; "numba" the kernels.
"""

import itertools
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor

from novags.splats.cpu.parallel import run
from novags.splats.cpu.training import noise
from novags.splats.gaussians import Gaussians
from novags.splats.training.config import LearningRates
from novags.splats.training.updates import adam, mcmc
from novags.splats.training.updates.activate import activate
from tests.stability.case import EPS, Case, Error, Fails, Part, Setting, relative_error, worse, worst_error

PART = Part("updates")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

TINY = float(torch.finfo(torch.float32).tiny)  # smallest normal number
BOTH = ("numba", "torch")
Array = np.ndarray


def _gaussians(logits: Tensor, log_scales: Tensor) -> Gaussians:
    """In these opacities and sizes, turned and placed at random, float32."""
    n, g = len(logits), torch.Generator().manual_seed(0)
    return Gaussians(
        means=torch.randn(n, 3, generator=g), quats=torch.randn(n, 4, generator=g),
        log_scales=log_scales.float().expand(n, 3).contiguous(), logit_opacities=logits.float().contiguous(),
        sh=torch.randn(n, 1, 3, generator=g),
    )  # fmt: skip


@PART.case("activations: logits +-100, log scales +-40", bound=60 * EPS, unit="of each value", backends=BOTH)
def activations(setting: Setting) -> float:
    """exp(x) has the rounding of x, |x| EPS / 2, as its relative error: 40 EPS / 2, and as much from the kernel's.

    Beyond e^-87 float32 has no normal numbers: there the error is one of them.
    """
    logits = torch.tensor([-100.0, -88, -87, -50, -17, -1, 0, 1, 17, 50, 88, 100])
    made = _gaussians(logits, torch.linspace(-40, 40, 36).reshape(12, 3)).requires_grad_()
    scales, opacities, _ = activate(made, 0.0, 0.0, fused=setting.backend == "numba")
    (scales.sum() + opacities.sum()).backward()
    worst = 0.0
    with mpmath.workdps(40):
        for x, found, slope in _rows(made.log_scales, scales, made.log_scales.grad):
            exact = mpmath.exp(x)
            worst = worse(worst, float(abs(found - exact) / exact), float(abs(slope - exact) / exact))
        for x, found, slope in _rows(logits, opacities, made.logit_opacities.grad):
            o = 1 / (1 + mpmath.exp(-x))
            # the slope o (1 - o) has the rounding of o near 1
            worst = worse(worst, float(abs(found - o) / (o + TINY / EPS)), float(abs(slope - o * (1 - o))))
    return worst


def _rows(*tensors: Tensor | None) -> list[list[float]]:
    """Numbers at the same place."""
    columns = [tensor.detach().double().flatten() for tensor in tensors if tensor is not None]
    return torch.stack(columns, 1).tolist()


def _adam_steps(gradients: Array, first: Array, second: Array, count: int, rate: float) -> Array:
    """The value after steps from 0, in float64."""
    value, first, second = np.zeros(len(first)), first.copy(), second.copy()
    for gradient in gradients.astype(np.float64):
        count += 1
        first += (gradient - first) * 0.1
        second += (gradient**2 - second) * 0.001
        value -= rate * first / (1 - 0.9**count) / (np.sqrt(second / (1 - 0.999**count)) + 1e-15)
    return value


@contextmanager
def _formulas_of(setting: Setting) -> Iterator[None]:
    """Whether Adam takes its kernel or its torch formula, on the CPU."""
    kernel = adam.Adam._update

    def formula(
        self: adam.Adam, value: Tensor, gradient: Tensor, first: Tensor, second: Tensor, rate: float, good: None
    ) -> None:
        corrections = 1 - adam.BETA1**self.count, math.sqrt(1 - adam.BETA2**self.count)
        adam._update_torch(value, gradient, first, second, rate, *corrections)

    if setting.backend == "torch":
        adam.Adam._update = formula
    try:
        yield
    finally:
        adam.Adam._update = kernel


@PART.case("Adam: gradients of 1e-38 to 1e15, denormal moments", bound=1e-4, unit="of the rate", backends=BOTH)
def denormal_moments(setting: Setting) -> float:
    """Five steps at the first count, and after a million.

    1 - beta2 of a float32 beta2 is off by 1.3e-5, half of it in a step; late steps after none are 3 rates long. Squares
    of gradients below 1e-19 leave float32, where the root is below the epsilon of 1e-15 all the same.
    """
    sizes = 10.0 ** np.arange(-38, 16)
    rng, worst = np.random.default_rng(0), 0.0
    gradients = (rng.uniform(0.5, 1, (5, len(sizes))) * np.where(rng.random(len(sizes)) < 0.5, 1, -1) * sizes).astype(
        "f4"
    )
    for count, first, second in ((0, 0.0, 0.0), (0, 1e-40, 1e-42), (10**6, 1e-40, 1e-42), (10**6, -1e-20, 1e-38)):
        made = _gaussians(torch.zeros(len(sizes)), torch.zeros(1, 3))
        optimiser = adam.Adam(made)
        optimiser.count = count
        optimiser.first["logit_opacities"].fill_(first)
        optimiser.second["logit_opacities"].fill_(second)
        start = [m["logit_opacities"].double().numpy() for m in (optimiser.first, optimiser.second)]
        rates = LearningRates(logit_opacities=1.0)
        with _formulas_of(setting):
            for gradient in gradients:
                made.logit_opacities.grad = torch.from_numpy(gradient)
                optimiser.step(made, rates, 0.0)
        wanted = _adam_steps(gradients, start[0], start[1], count, 1.0)
        worst = worse(worst, float(np.abs(made.logit_opacities.double().numpy() - wanted).max()))
        if not all(torch.isfinite(m["logit_opacities"]).all() for m in (optimiser.first, optimiser.second)):
            return math.inf
    return worst / 5


@lru_cache  # the settings share it
def _relocated(opacity: mpmath.mpf, copies: int) -> tuple[mpmath.mpf, mpmath.mpf]:
    """New opacity and factor of the scale by the sum of 3DGS-MCMC (equation 9), with enough digits for its signs."""
    with mpmath.workdps(60):
        new = 1 - (1 - opacity) ** (mpmath.mpf(1) / copies)
        total = mpmath.mpf(0)
        for i in range(1, copies + 1):
            for k in range(i):
                total += mpmath.binomial(i - 1, k) * (-1) ** k * new ** (k + 1) / mpmath.sqrt(k + 1)
        return new, opacity / total


@PART.case("relocation: opacities .005 to 1 - 1e-7, up to 51 copies", bound=1e-14, unit="of each value")
def relocation_sum(setting: Setting) -> float:
    """The line integral against the alternating sum, in float64. Its 128 nodes converge to rounding: 2e-16."""
    worst = 0.0
    for opacity in (0.005, 0.0051, 0.3, 0.9, 0.999, 1 - 1e-7):
        for copies in (1, 2, 3, 10, 51):
            value = torch.tensor([opacity], dtype=torch.float64)
            found = mcmc.relocation(value, torch.tensor([copies]))
            exact = _relocated(mpmath.mpf(opacity), copies)
            worst = worse(worst, *(float(abs(float(f) - e) / e) for f, e in zip(found, exact, strict=True)))
    return worst


@PART.case("relocation of float32 Gaussians, 1 - 1e-7 among them", bound=20 * EPS, unit="of each logit and log scale")
def relocation_in_place(setting: Setting) -> float:
    """One live Gaussian takes up to 50 dead ones: logits and logs of the scales keep what sigmoid and exp would lose.

    A logit of 16 has an opacity of 1 - 1.1e-7, which float32 holds to one digit.
    """
    worst = 0.0
    for opacity in (0.0051, 0.5, 0.9999, 1 - 1e-7):
        for dead in (1, 50):
            logit = float(np.float32(math.log(opacity / (1 - opacity))))
            made = _gaussians(torch.tensor([logit] + [-9.0] * dead), torch.tensor([-30.0, 0.0, 30.0]))
            mcmc.relocate(made, torch.Generator().manual_seed(0))
            with mpmath.workdps(60):
                exact = 1 / (1 + mpmath.exp(-mpmath.mpf(logit)))
                new, factor = _relocated(exact, dead + 1)
                new = max(new, mpmath.mpf(mcmc.DEAD_OPACITY))  # as 3DGS-MCMC does: it would die again at once
                wanted = float(mpmath.log(new / (1 - new)))
                shift = float(mpmath.log(factor))
            pairs = [(made.logit_opacities, np.full(dead + 1, wanted))]
            pairs += [(made.log_scales[:, j], np.full(dead + 1, start + shift)) for j, start in enumerate((-30, 0, 30))]
            worst = max(worst, worst_error(pairs))
    return worst


def _normals(key: int, n: int) -> Array:
    """The kernel's stream, [N, 3]: SplitMix64 of the counter, 24 bits each for Box and Muller, in float64."""
    mask, values = 2**64 - 1, np.empty((n, 3))
    for i in range(3 * n):
        z = (key + (i + 1) * 0x9E3779B97F4A7C15) & mask
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        z ^= z >> 31
        u, t = ((z >> 40) + 1) / 2**24, ((z & 0xFFFFFF) - 2**23) / 2**24
        values[i // 3, i % 3] = math.sqrt(-2 * math.log(u)) * math.cos(2 * math.pi * t)
    return values


def _step_of_noise(made: Gaussians, xi: Array, amount: float, limit: float) -> Array:
    """Sigma xi amount sigmoid(100 (0.005 - o)) in float64, [N, 3], along each axis at most the limit."""
    q = made.quats.double().numpy()
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    turn = np.array([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])  # fmt: skip
    o = 1 / (1 + np.exp(-made.logit_opacities.double().numpy()))
    gate = amount / (1 + np.exp(100 * (o - 0.005)))
    along = np.einsum("ijn,ni->nj", turn, xi) * np.exp(2 * made.log_scales.double().numpy()) * gate[:, None]
    return np.einsum("ijn,nj->ni", turn, along.clip(-limit, limit))


@PART.case("noise at rates of 0 to 1e12, log scales -40 to 20", bound=100 * EPS, unit="of each step", backends=BOTH)
def noise_rates(setting: Setting) -> float:
    """Steps of 1e-35 to 1e29 world units, limited to 1 and free, each relative to its own length.

    exp(2 log scale) has the rounding of 80, 40 EPS, the gate's exponent of at most 30 that of 30; turning a round
    Gaussian there and back leaves some more.
    """
    worst, n = 0.0, 24
    for log_scale, limit in itertools.product((-40.0, -3.0, 0.0, 20.0), (1.0, math.inf)):
        for amount in (0.0, 1e-3, 80.0, 1e12):
            made = _gaussians(torch.linspace(-30, -0.9, n), torch.full((1, 3), log_scale))
            made.means.zero_()
            if setting.backend == "numba":
                xi, key = _normals(12345, n), np.uint64(12345)
                arrays = (t.numpy() for t in (made.means, made.quats, made.log_scales, made.logit_opacities))
                run(noise.add, n, 16, *arrays, np.float32(amount), np.float32(limit), key)
            else:
                xi = torch.randn(n, 3, generator=torch.Generator().manual_seed(3)).double().numpy()
                mcmc._add_noise_torch(made, amount, torch.Generator().manual_seed(3), limit)
            wanted = _step_of_noise(made, xi, amount, limit)
            length = np.linalg.norm(wanted, axis=1, keepdims=True)
            off = np.abs(made.means.double().numpy() - wanted) / np.maximum(length, TINY / EPS)
            worst = max(worst, float(off.max())) if np.isfinite(off).all() else math.inf
    return worst


@PART.case("noise of opaque Gaussians", bound=0, unit="of a mean", backends=BOTH)
def opaque(setting: Setting) -> float:
    """Opaque Gaussians stay where they are, whatever their size: the gate is below rounding, not the step."""
    made = _gaussians(torch.tensor([0.0, 5.0, 100.0]), torch.tensor([[-40.0, 0.0, 3.0]]))
    before = made.means.clone()
    if setting.backend == "numba":
        mcmc.add_noise(made, 80.0, torch.Generator().manual_seed(0))
    else:
        mcmc._add_noise_torch(made, 80.0, torch.Generator().manual_seed(0))
    return relative_error(made.means, before)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_an_epsilon_too_large_for_small_gradients_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adam, "EPS", 1e-8)
    for backend in ("numba", "torch"):
        assert fails("Adam: gradients of 1e-38 to 1e15, denormal moments", backend)


def test_the_alternating_sum_in_float64_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def alternating(opacities, copies):
        o, n = opacities.double(), int(copies[0])
        new = 1 - (1 - o) ** (1 / n)
        k = torch.arange(n, dtype=torch.float64)
        total = torch.zeros_like(o)
        for i in range(n):
            binomial = torch.exp(torch.lgamma(torch.tensor(i + 1.0).double()) - torch.lgamma(k[: i + 1] + 1)
                                 - torch.lgamma(i - k[: i + 1] + 1))  # fmt: skip
            total += (binomial * (-1) ** k[: i + 1] * new ** (k[: i + 1] + 1) / torch.sqrt(k[: i + 1] + 1)).sum()
        return new.to(opacities.dtype), (o / total).to(opacities.dtype)

    monkeypatch.setattr(mcmc, "relocation", alternating)
    assert fails("relocation: opacities .005 to 1 - 1e-7, up to 51 copies", "torch")


def test_opacities_in_float32_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    relocation = mcmc.relocation
    monkeypatch.setattr(mcmc, "relocation", lambda o, n: relocation(o.float().clamp_max(1 - 6e-8).double(), n))
    assert fails("relocation of float32 Gaussians, 1 - 1e-7 among them", "torch")


def test_noise_that_forgets_the_rotation_or_the_gate_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    rotation = mcmc.quat_to_rotmat
    monkeypatch.setattr(mcmc, "quat_to_rotmat", lambda q: rotation(q) * (1 + 2e-5))
    assert fails("noise at rates of 0 to 1e12, log scales -40 to 20", "torch")
    monkeypatch.setattr(mcmc, "DEAD_OPACITY", 1.0)
    assert fails("noise of opaque Gaussians", "torch")


def test_another_stream_of_the_kernel_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    normals = _normals
    monkeypatch.setattr(HERE, "_normals", lambda key, n: normals(key + 1, n))
    assert fails("noise at rates of 0 to 1e12, log scales -40 to 20", "numba")
    assert noise.LANES == 16
    assert np.isfinite(normals(0, 4)).all()


def test_exponentials_of_half_precision_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    exp = torch.exp
    monkeypatch.setattr(torch, "exp", lambda x: exp(x.bfloat16().float()))
    assert fails("activations: logits +-100, log scales +-40", "torch")


def test_a_nan_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, relocation = activate, mcmc.relocation
    monkeypatch.setattr(HERE, "activate", lambda *given, **how: [np.nan * x for x in plain(*given, **how)])
    monkeypatch.setattr(adam, "_update_torch", lambda value, *rest: value.fill_(np.nan))
    monkeypatch.setattr(mcmc, "relocation", lambda o, n: tuple(np.nan * x for x in relocation(o, n)))
    assert fails("activations: logits +-100, log scales +-40", "torch")
    assert fails("Adam: gradients of 1e-38 to 1e15, denormal moments", "torch")
    assert fails("relocation: opacities .005 to 1 - 1e-7, up to 51 copies", "torch")
