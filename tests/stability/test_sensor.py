"""Every hard case of the camera holds; and with each formula as one would first write it, its case does not."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import special

from novags.testbed.stability import PARTS, Case, Setting, measured
from sensor_model import capture, effects, isp, moments
from sensor_model.fast import capture_fused
from sensor_model.frame import prepare, streams

NUMPY, NUMBA = Setting("numpy", 1), Setting("numba", 1)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def holds(start: str, setting: Setting = NUMPY) -> bool:
    """Whether the case whose name starts so holds now."""
    (case,) = [case for case in PARTS["sensor"].cases if case.name.startswith(start)]
    return measured(case, setting).holds


def cast_first(signal: Any, max_dn: int, width: Any = 1.0) -> Any:
    with np.errstate(invalid="ignore"):
        return np.clip(np.rint(signal).astype(np.int64).astype(np.uint16), 0, max_dn)


def half_up(signal: Any, max_dn: int, width: Any = 1.0) -> Any:
    return np.clip(np.floor(np.floor(signal / width + 0.5) * width + 0.5), 0, max_dn).astype(np.uint16)


def tukey_by_powers(u: Any, lam: float) -> Any:
    with np.errstate(all="ignore"):
        return (u**lam - (1 - u) ** lam) / lam if lam else np.log(u / (1 - u))


def normal_for_poisson(u: Any, mu: Any) -> Any:
    return np.maximum(np.rint(mu + np.sqrt(mu) * special.ndtri(u)), 0)


def rounding_adds_a_twelfth(level: Any, sd: Any, top: Any) -> Any:
    return np.clip(level, 0, top), np.broadcast_to(sd**2 + 1 / 12, level.shape)


@pytest.mark.parametrize(
    ("module", "name", "naive", "case"),
    [
        (effects, "digitise", cast_first, "codes below 0"),
        (effects, "digitise", half_up, "signals half way"),
        (effects, "nonlinear", lambda electrons, droop: electrons, "the three noise-free channels"),
        (effects, "full_well", lambda charge, full: charge, "full pixels"),
        (isp, "white_balance", lambda sensor: np.ones(3), "full pixels"),
        (effects, "tukey_quantile", tukey_by_powers, "Tukey-lambda at u"),
        (effects, "tukey_sd", lambda lam: np.sqrt(2 / lam**2 * (1 / (1 + 2 * lam) - special.beta(lam + 1, lam + 1)))
         if lam else np.pi / np.sqrt(3), "Tukey-lambda's standard"),
        (effects, "shot_noise", normal_for_poisson, "Poisson quantiles"),
        (moments, "code_moments", rounding_adds_a_twelfth, "analytic moments"),
        (moments, "code_moments", rounding_adds_a_twelfth, "8 bits after"),
        (moments, "code_moments", rounding_adds_a_twelfth, "black at 0, 1 and 3 deviations: K sigma"),
        (prepare, "charge_cap", lambda sensor: sensor.mu_e_sat, "light of 1e6"),
        (capture, "check_light", lambda light, what: None, "light that is nan"),
    ],
)  # fmt: skip
def test_a_formula_as_first_written_exceeds_its_bound(
    module: Any, name: str, naive: Callable, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert holds(case)
    monkeypatch.setattr(module, name, naive)
    with np.errstate(all="ignore"):
        assert not holds(case)


def test_read_noise_that_is_cut_at_black_shows_in_the_mean_of_many_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(u: Any, sigma: Any, lam: Any) -> Any:
        return np.maximum(sigma * special.ndtri(u), 0)

    monkeypatch.setattr(effects, "read_noise", cut)
    assert not holds("black at 0, 1 and 3 deviations: mean")


def test_one_stream_for_two_effects_shows_in_the_read_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn one after the other, as from a generator with a state, the read noise depends on the charge before it."""
    state: dict[str, np.random.Generator] = {}

    def uniforms(self: streams.Draws, shape: tuple[int, ...], stream: int) -> Any:
        if stream == streams.SHOT or "rng" not in state:
            state["rng"] = np.random.default_rng(0)
        return state["rng"].random(shape)

    monkeypatch.setattr(streams.Draws, "uniforms", uniforms)
    assert not holds("more light")


def test_draws_that_depend_on_what_was_drawn_before_show_in_the_frames_of_several_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    count = itertools.count()
    here = capture_fused.address
    monkeypatch.setattr(capture_fused, "address", lambda draws: (np.uint64(next(count)), *here(draws)[1:]))
    assert not holds("the same frame", NUMBA)


@pytest.mark.parametrize("words", [0, streams.MASK])
def test_the_outermost_random_numbers_are_neither_zero_nor_one(words: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "philox", lambda c, key: tuple(np.full(c[0].shape, words, np.uint64) for _ in c))
    u = streams.Draws(seed=0).uniforms((2, 2), streams.READ)
    assert ((u > 0) & (u < 1)).all()
    assert (u == (2.0**-53 if words == 0 else 1 - 2.0**-53)).all()
    for lam in (-0.45, 0.0, 0.9):
        assert np.isfinite(effects.tukey_quantile(u, lam)).all()
