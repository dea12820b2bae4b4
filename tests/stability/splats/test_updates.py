from collections.abc import Callable

import numpy as np
import pytest
import torch

from novags.splats.cpu.training import noise
from novags.splats.training.updates import adam, mcmc
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.splats import updates

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


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
    assert fails("relocation: opacities .005 to 1 - 1e-7, up to 51 copies")


def test_opacities_in_float32_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    relocation = mcmc.relocation
    monkeypatch.setattr(mcmc, "relocation", lambda o, n: relocation(o.float().clamp_max(1 - 6e-8).double(), n))
    assert fails("relocation of float32 Gaussians, 1 - 1e-7 among them")


def test_noise_that_forgets_the_rotation_or_the_gate_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    rotation = mcmc.quat_to_rotmat
    monkeypatch.setattr(mcmc, "quat_to_rotmat", lambda q: rotation(q) * (1 + 2e-5))
    assert fails("noise at rates of 0 to 1e12, log scales -40 to 20")
    monkeypatch.setattr(mcmc, "DEAD_OPACITY", 1.0)
    assert fails("noise of opaque Gaussians")


def test_another_stream_of_the_kernel_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    normals = updates._normals
    monkeypatch.setattr(updates, "_normals", lambda key, n: normals(key + 1, n))
    assert fails("noise at rates of 0 to 1e12, log scales -40 to 20", "numba")
    assert noise.LANES == 16
    assert np.isfinite(normals(0, 4)).all()


def test_exponentials_of_half_precision_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    exp = torch.exp
    monkeypatch.setattr(torch, "exp", lambda x: exp(x.bfloat16().float()))
    assert fails("activations: logits +-100, log scales +-40")


def test_a_nan_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    activate, relocation = updates.activate, mcmc.relocation
    monkeypatch.setattr(updates, "activate", lambda *given, **how: [np.nan * x for x in activate(*given, **how)])
    monkeypatch.setattr(adam, "_update_torch", lambda value, *rest: value.fill_(np.nan))
    monkeypatch.setattr(mcmc, "relocation", lambda o, n: tuple(np.nan * x for x in relocation(o, n)))
    assert fails("activations: logits +-100, log scales +-40")
    assert fails("Adam: gradients of 1e-38 to 1e15, denormal moments")
    assert fails("relocation: opacities .005 to 1 - 1e-7, up to 51 copies")
