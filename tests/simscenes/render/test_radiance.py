"""Radiance of a view: its mean and variance, samples that stay stratified, repeatability, and targets of error."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, orbit_rig
from simscenes.backend import activate, using_variant
from simscenes.camera import camera_color
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.render.geometry import geometry_channels
from simscenes.render.motion import subframe_rig
from simscenes.render.radiance import MAX_FILM_SPP, RenderedView, RenderMethod, grid_spp, view_seed
from simscenes.render.sensors import sensor_dict
from simscenes.render.sequences import count_fireflies, summary
from simscenes.rigs import intrinsics

GRAY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}}
Scene = Callable[[], dict[str, Any]]
Camera = Callable[..., Rig]


def radiance(
    loaded: LoadedScene, rig: Rig, *, spp: int | None = None, target_error: float | None = None, seed: int = 0
) -> Any:
    mi = activate()
    integrator = mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 2})
    return RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator, seed=seed), rig, 0).render(spp, target_error)


@pytest.mark.parametrize("ground", [20.0, 2e4, 2e6])
def test_what_stands_before_the_cameras_is_in_the_picture_however_large_the_scene(ground: float, view: Camera) -> None:
    """A near plane in proportion to the scene would hide it, from the picture alone."""
    mi = activate()
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 0.0, 0.0]}}
    flat = mi.ScalarTransform4f().translate([0, 0, -1]) @ mi.ScalarTransform4f().scale(ground)
    loaded = build_scene(
        {"type": "scene", "ball": {"type": "sphere", "radius": 0.5, "emitter": lamp},
         "ground": {"type": "rectangle", "to_world": flat}}, mi,
    )  # fmt: skip
    rig = view(40, 30)
    ball = geometry_channels(mi, loaded, rig, 0)["id"] == 1 + loaded.shapes.index("ball")
    inner = ball & np.roll(ball, 1, 0) & np.roll(ball, -1, 0) & np.roll(ball, 1, 1) & np.roll(ball, -1, 1)
    assert inner.sum() > 4
    assert radiance(loaded, rig, spp=4).mean[inner] == pytest.approx(np.tile([1, 0, 0], (inner.sum(), 1)))


def test_the_noise_of_a_view_is_known_by_its_camera_its_size_the_seed_and_the_part() -> None:
    rig = orbit_rig(3, 16, 12, 50.0, radius=3.0)
    longer = replace(rig, Ks=rig.Ks * np.array([1.1, 1.1, 1.0])[:, None])
    seeds = [
        view_seed(rig, 0, 7, 1, 2), view_seed(rig, 1, 7, 1, 2), view_seed(longer, 0, 7, 1, 2),
        view_seed(replace(rig, width=15), 0, 7, 1, 2), view_seed(replace(rig, height=13), 0, 7, 1, 2),
        view_seed(rig, 0, 8, 1, 2), view_seed(rig, 0, 7, 0, 2), view_seed(rig, 0, 7, 1, 3),
    ]  # fmt: skip
    assert len(set(seeds)) == len(seeds)
    turned = replace(rig, viewmats=rig.viewmats[::-1], Ks=rig.Ks[::-1])
    assert view_seed(turned, 2, 7, 1, 2) == seeds[0]  # not by its place


def test_a_view_in_motion_is_seen_from_every_place_of_its_exposure(ball_on_plane: Scene) -> None:
    mi = activate()
    integrator, rig = mi.load_dict({"type": "path"}), orbit_rig(5, 16, 12, 50.0, radius=3.0)
    method = RenderMethod(
        mi, mi.variant(), build_scene(ball_on_plane(), mi), integrator, optics=Optics(motion=0.4), subframes=4
    )
    sensors = RenderedView(method, rig, 2).sensors
    found = [np.array(sensor.world_transform().matrix).reshape(4, 4)[:3, 3] for sensor in sensors]
    np.testing.assert_allclose(found, subframe_rig(rig, 2, 0.4, 4).positions, atol=1e-5)


def test_variance_estimate_equals_the_spread_over_many_seeds(ball_on_plane: Scene, view: Camera) -> None:
    """Rationale: the spread of n = 60 independent renders has relative SE sqrt(2/(n-1)) per independent pixel.

    Both in sum over the view, and in each pixel for its 3 x 3 neighbourhood, which shares one variance.
    """
    loaded, rig, n = build_scene(ball_on_plane(), activate()), view(12, 9), 60
    runs = [radiance(loaded, rig, spp=8, seed=k) for k in range(n)]
    means = np.stack([r.mean for r in runs]).astype(np.float64)
    estimates = np.stack([r.variance for r in runs]).astype(np.float64)
    true = means.var(0, ddof=1)
    # Per-seed estimates scatter by themselves; the truth's own error comes from its noisiest pixels.
    each = estimates.mean((1, 2, 3))
    se = np.hypot(each.std(ddof=1) / np.sqrt(n), np.sqrt(2 / (n - 1)) * np.linalg.norm(true) / true.size)
    assert each.mean() == pytest.approx(true.mean(), abs=5 * se)
    assert se < 0.2 * true.mean()
    padded = np.pad(true, ((1, 1), (1, 1), (0, 0)), mode="symmetric")
    around = np.stack([padded[y : y + 9, x : x + 12] for y in range(3) for x in range(3)])
    fourth = np.linalg.norm(around, axis=0) / 9 * np.sqrt(2 / (n - 1))
    pixel = (estimates.mean(0) - around.mean(0)) / np.hypot(estimates.std(0, ddof=1) / np.sqrt(n), fourth).clip(1e-12)
    assert np.abs(pixel).max() < 6  # 324 values whose variances are themselves estimated from skew ones
    assert np.median(estimates.std(0, ddof=1) / estimates.mean(0).clip(1e-12)) < 0.8  # 1.4 if each pixel had its own


def test_samples_in_two_sequences_are_almost_as_good_as_in_one_block(view: Camera) -> None:
    """A lamp over a matt floor, direct light: the worst case, where stratified samples gain most by being many.

    Root mean square over 8 seeds of 432 pixels each, whose relative error is some 1 / sqrt(2 * 8 * 432) = 1 %. In four
    passes of 16 the error is 1.33 times that of one pass.
    """
    mi = activate()
    lamp = mi.ScalarTransform4f().translate([0, 0, 6]).rotate([1, 0, 0], 180).scale(1.5)
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 9.0}}
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(30), "bsdf": GRAY}
    scene = {"type": "scene", "floor": floor, "lamp": {"type": "rectangle", "to_world": lamp, "emitter": glow}}
    loaded, rig = build_scene(scene, mi), view(24, 18)
    integrator = mi.load_dict({"type": "path", "max_depth": 2, "rr_depth": 3})
    ours, whole = [], []
    for seed in range(8):
        method = RenderMethod(mi, mi.variant(), loaded, integrator, seed=seed)
        ours.append(RenderedView(method, rig, 0).render(64, None).mean)
        sensor = mi.load_dict(
            sensor_dict(mi, rig, 0, loaded) | {"sampler": {"type": "multijitter", "sample_count": 64}}
        )
        image = mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=64, seed=seed)
        whole.append(np.array(image, dtype=np.float64)[..., :3])
    errors = [float(np.sqrt(np.var(images, axis=0, ddof=1).mean())) for images in (ours, whole)]
    assert errors[0] < 1.2 * errors[1]


@pytest.mark.parametrize("spp", [1, 2, 3, 5, 9, 17, 64, 250, 1000, 1024])
def test_scalar_films_have_as_many_samples_as_their_sampler_can_stratify(spp: int) -> None:
    size = grid_spp(spp)
    sampler = activate().load_dict({"type": "multijitter", "sample_count": size})
    assert sampler.sample_count() == size  # not rounded up to what it can stratify
    assert spp <= size < spp * (1 + 2 / np.sqrt(spp)) + 1  # at most one row of the grid more than needed


def test_a_scalar_variant_counts_what_it_draws_and_never_repeats_itself(view: Camera, ball_on_plane: Scene) -> None:
    """Each half in films of at most 1024 samples, rounded up to what can be stratified; other samples every time."""
    with using_variant("scalar") as mi:
        loaded, rig = build_scene(ball_on_plane(), mi), view(4, 3)
        integrator = mi.load_dict({"type": "path", "max_depth": 2})
        one = RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator), rig, 0)
        one.render(9, None)
        assert (one.samples.count == 6).all()  # 5 asked in each half, 2 x 3 drawn
        sums = one.samples.sums.copy()
        one._draw(np.full((3, 4), 4))
        again = one.samples.sums - sums
        assert one.samples.spp == 20
        differs = [np.abs(a - b).max() > 1e-3 for a, b in ((sums[0], sums[1]), (sums[0], again[0]), (*again,))]
        assert all(differs)
        drawn = [sums.max() for *_, sums in one._light(one.sensors[0], np.zeros(12), np.full(12, 2500), 0)]
    assert len(drawn) == 6
    assert drawn[2] / drawn[0] == pytest.approx((2500 - 2 * MAX_FILM_SPP) / MAX_FILM_SPP, rel=0.1)


def test_a_variance_is_never_negative() -> None:
    """The running sums of a box filter can end below zero where nothing varies."""
    variance = np.zeros((40, 40, 3))
    variance[:, :13] = np.random.default_rng(0).gamma(1.0, 1e-3, (40, 13, 3))
    found = summary(np.ones_like(variance), np.sqrt(variance), 8).variance
    assert (found >= 0).all()
    assert (found[:, 16:] < 1e-15).all()
    assert found.mean() == pytest.approx(variance.mean())


def test_the_same_seed_gives_the_same_bits_where_threads_share_the_work(ball_on_plane: Scene, view: Camera) -> None:
    """Enough samples for many work units, with pixels that straddle them: a film of float32 would differ."""
    loaded, rig = build_scene(ball_on_plane(), activate()), view(128, 97)
    first = radiance(loaded, rig, spp=100)
    for _ in range(3):
        again = radiance(loaded, rig, spp=100)
        assert np.array_equal(again.mean, first.mean)
        assert np.array_equal(again.variance, first.variance)


def test_sixty_five_thousand_samples_add_up_without_float32_bias() -> None:
    """A sky of 1/3 is exact in every sample; one float32 sum over 65536 of them is off by 1e-4."""
    mi = activate()
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1 / 3}}
    far = {"type": "sphere", "center": [0, 0, -1e3], "radius": 100.0}
    loaded = build_scene({"type": "scene", "sky": sky, "far": far}, mi)
    result = radiance(
        loaded, Rig(viewmats=np.eye(4)[None], Ks=intrinsics(4, 3, 40)[None], width=4, height=3), spp=65536
    )
    assert np.abs(result.mean * 3 - 1).max() < 3e-6


def test_a_firefly_is_counted_and_an_even_field_is_not() -> None:
    variance = np.random.default_rng(0).gamma(1.0, 1e-4, (20, 20))
    assert count_fireflies(variance, level=1.0) == 0
    variance[7, 7] = 1.0
    assert count_fireflies(variance, level=1.0) == 1


def test_target_error_is_reached_and_not_by_chance_only(ball_on_plane: Scene, view: Camera) -> None:
    loaded, rig = build_scene(ball_on_plane(), activate()), view(24, 18)
    result = radiance(loaded, rig, target_error=0.02)
    assert result.error <= 0.02
    reference = radiance(loaded, rig, spp=2048, seed=9)
    actual = np.sqrt(((result.mean - reference.mean) ** 2).mean()) / reference.mean.mean()
    assert actual < 0.02 * 1.5


def test_a_scalar_variant_reaches_a_target_evenly(ball_on_plane: Scene, view: Camera) -> None:
    with using_variant("scalar") as mi:
        loaded, rig = build_scene(ball_on_plane(), mi), view(8, 6)
        integrator = mi.load_dict({"type": "path", "max_depth": 4, "rr_depth": 2})
        result = RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator), rig, 0).render(None, 0.1)
    assert result.error <= 0.1
    assert result.spp >= 16


@pytest.mark.parametrize("away", [3.0, 300.0, 3000.0])
def test_a_small_thing_is_seen_from_far_away(away: float) -> None:
    """A grey ball before a bright sky, through a lens that always shows it at the same size."""
    mi = activate()
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.2}}
    loaded = build_scene({"type": "scene", "ball": {"type": "sphere", "bsdf": paint}, "sky": {"type": "constant"}}, mi)
    rig = orbit_rig(1, 9, 9, float(np.degrees(2 * np.arctan(2 / away))), target=(0, 0, 0), radius=away)
    picture = (
        RenderedView(RenderMethod(mi, mi.variant(), loaded, mi.load_dict({"type": "path"})), rig, 0)
        .render(64, None)
        .mean
    )
    assert picture[4, 4] == pytest.approx(0.2, rel=0.02)
    assert picture[0, 0] == pytest.approx(1.0)


def test_a_cameras_colours_are_those_of_its_matrix(view: Camera) -> None:
    """In even light of one colour; the matrix is neither symmetric nor the identity."""
    mi, light, camera = activate(), np.array([0.9, 0.5, 0.2]), "Nikon 5100 (NPL)"
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": light.tolist()}}
    speck = {"type": "sphere", "center": [0, 0, -50], "radius": 1.0}  # a scene needs a shape
    loaded = build_scene({"type": "scene", "sky": sky, "speck": speck}, mi)
    method = RenderMethod(mi, mi.variant(), loaded, mi.load_dict({"type": "path"}), optics=Optics(camera=camera))
    mean = RenderedView(method, view(4, 3), 0).render(4, None).mean
    np.testing.assert_allclose(mean, np.broadcast_to(camera_color(camera).matrix @ light, (3, 4, 3)), rtol=1e-5)


def test_another_seed_gives_another_picture_in_a_scalar_variant_too(view: Camera, ball_on_plane: Scene) -> None:
    with using_variant("scalar") as mi:
        loaded, rig = build_scene(ball_on_plane(), mi), view(4, 3)
        integrator = mi.load_dict({"type": "path", "max_depth": 3})
        first, again, other = (
            RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator, seed=seed), rig, 0).render(4, None).mean
            for seed in (0, 0, 1)
        )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
