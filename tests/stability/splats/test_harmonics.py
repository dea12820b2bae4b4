from collections.abc import Callable

import numpy as np
import pytest
import torch

from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.splats import harmonics

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_harmonics_from_angles_are_noticed_at_the_poles(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = harmonics.sh_colors

    def from_angles(degree, directions, sh):
        x, y, z = torch.nn.functional.normalize(directions, dim=-1).unbind(-1)
        polar, azimuth = torch.acos(z), torch.atan2(y, x)
        sine = torch.sin(polar)
        return colors(degree, torch.stack([sine * azimuth.cos(), sine * azimuth.sin(), polar.cos()], -1), sh)

    monkeypatch.setattr(harmonics, "sh_colors", from_angles)
    assert fails("poles and what is near them")


def test_a_length_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = harmonics.sh_colors
    monkeypatch.setattr(harmonics, "sh_colors", lambda d, x, sh: colors(d, x / x.norm(dim=-1, keepdim=True), sh))
    assert fails("a Gaussian at the camera's centre")


def test_half_precision_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = harmonics.sh_colors
    monkeypatch.setattr(harmonics, "sh_colors", lambda d, x, sh: colors(d, x, sh.bfloat16().float()))
    for name in ("poles and what is near them", "directions of length 1e-9 to 1e15", "coefficients of 1e6"):
        assert fails(name), name


def test_coefficients_beyond_the_degree_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = harmonics.sh_colors
    monkeypatch.setattr(harmonics, "sh_colors", lambda d, x, sh: colors(d, x, sh) + 0 * sh.sum((1, 2))[:, None])
    assert fails("another degree: what lies above it may be anything")


def test_the_reference_has_the_signs_of_3dgs() -> None:
    raw = np.concatenate([[0, 0, 2.0], np.eye(16)[2].repeat(3), np.ones(3)])
    color, _, v_sh = harmonics._exact(raw.tobytes(), 1, 3)
    assert color[0] == pytest.approx([0.5 + 0.4886025119029199] * 3, rel=1e-14)
    assert v_sh[0, 6, 0] == pytest.approx(2 * 0.31539156525252005, rel=1e-14)


def test_slopes_above_the_degree_that_are_left_as_they_were_are_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed = harmonics._computed

    def left(setting, directions, sh, weights, degree):
        colors, v_directions, v_sh = computed(setting, directions, sh, weights, degree)
        v_sh[:, (degree + 1) ** 2 :] = np.nan
        return colors, v_directions, v_sh

    monkeypatch.setattr(harmonics, "_computed", left)
    assert fails("another degree: what lies above it may be anything")
