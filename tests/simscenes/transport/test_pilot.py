"""What pilots say of the light that is missing or changed is true of what they were given."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from simscenes import default_rig
from simscenes.backend import activate
from simscenes.loading.load import build_scene
from simscenes.transport.pilot import MOST, Share, beyond, changed_light, missing_light, most_reflected, pilot_rig

SceneMaker = Callable[..., dict[str, Any]]


def test_missing_light_counts_the_mean_and_bounds_it() -> None:
    rng = np.random.default_rng(0)
    full = np.ones((2, 3, 32, 32, 3))
    lacking = rng.exponential(0.01, (3, 32, 32, 1)) * np.ones(3)
    share = missing_light(full, full - lacking)
    assert share.estimate == pytest.approx(lacking.mean())
    assert share.upper == pytest.approx(0.01, rel=0.15)
    assert share.upper > 0.01
    assert missing_light(np.zeros_like(full), np.zeros_like(full)).upper == 0


def test_the_interval_beyond_a_cut_holds_a_geometric_series() -> None:
    """Light (1 - a) a^k after k bounces: a pilot to depth 64 misses a^64 of it, which the upper end must cover."""
    for albedo in (0.5, 0.9, 0.98):
        for depth in (8, 16, 32):
            found = albedo**depth - albedo**64
            cut = beyond(Share(found, found), Share(0.0, 0.0), 64 - depth, albedo)
            assert cut.estimate <= albedo**depth
            assert cut.upper == pytest.approx(albedo**depth)


def test_the_most_a_bounce_keeps_is_that_of_the_brightest_surface_seen_or_not(diffuse_box: SceneMaker) -> None:
    mi = activate()
    hidden = {"type": "sphere", "center": [0, 0, -50], "bsdf": {"type": "diffuse", "reflectance": 0.9}}
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(np.full((4, 4, 3), 0.95, np.float32)), "raw": True}
    textured = {"type": "sphere", "bsdf": {"type": "twosided", "b": {"type": "diffuse", "reflectance": bitmap}}}
    front, back = ({"type": "diffuse", "reflectance": value} for value in (0.2, 0.8))
    two, turned = ({"type": "sphere", "bsdf": {"type": "twosided", "a": a, "b": b}}
                   for a, b in ((front, back), (back, front)))  # fmt: skip
    for sides in (two, turned):
        assert most_reflected(mi, build_scene(diffuse_box(s=sides), mi)) == pytest.approx(0.8)
    for more, most in (({}, 0.7), ({"h": hidden}, 0.9), ({"h": hidden, "t": textured}, 0.95)):
        assert most_reflected(mi, build_scene(diffuse_box(**more), mi)) == pytest.approx(most)
    fog = {"type": "homogeneous", "sigma_t": 0.1, "albedo": 0.99}
    cloud = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    metal = {"type": "sphere", "bsdf": {"type": "conductor"}}
    assert most_reflected(mi, build_scene(diffuse_box(c=cloud), mi)) == MOST
    assert most_reflected(mi, build_scene(diffuse_box(m=metal), mi)) == MOST


def test_changed_light_averages_noise_away_but_not_change() -> None:
    rng = np.random.default_rng(0)
    full = np.ones((2, 3, 32, 32, 3))
    noisy = full + rng.normal(0, 0.1, full.shape)
    assert changed_light(full, noisy).upper < 0.02
    half = full.copy()
    half[:, :, :16] *= 1.1
    assert changed_light(full, half).estimate == pytest.approx(0.05)


def test_pilots_keep_the_field_of_view() -> None:
    rig = default_rig("cornell", 9, 640, 480)
    small = pilot_rig(rig)
    assert (len(small), small.width, small.height) == (3, 32, 24)
    corners = np.array([[0.0, 0], [640, 480]])
    for K, w, h, place in ((rig.Ks[0], 640, 480, corners), (small.Ks[0], 32, 24, corners / 20)):
        rays = (place - K[:2, 2]) / np.diag(K)[:2]
        assert np.allclose(rays, [[-w / 2 / K[0, 0], -h / 2 / K[1, 1]], [w / 2 / K[0, 0], h / 2 / K[1, 1]]])
