"""Claims about the points a reconstruction starts from: as many as asked for, and where the scene is."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from novags.cameras.first import FirstPoints, _around_focus, from_depths, from_model, from_pictures
from novags.cameras.points import fill, project, seen_colors, unproject
from novags.methods import METHODS
from novags.methods.enhanced.gaussian_fit import fit_for
from novags.methods.problem import Problem
from novags.methods.start import start_gaussians
from novags.splats import FitConfig, McmcConfig, Views
from novags.splats.training.fit import fit
from novags.testbed.metrics.images import aligned_psnr

SIZE, VIEWS = 40, 8
MakeCorner = Callable[..., Any]


@pytest.fixture(scope="module")
def scene(corner: MakeCorner) -> Any:
    return corner(VIEWS, SIZE, SIZE)


def pictures(scene: Any) -> np.ndarray:
    return scene.pictures.astype(np.float32) / 255


def cameras(scene: Any) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(scene.rig.viewmats), np.asarray(scene.rig.Ks)


def model(scene: Any, count: int) -> np.ndarray:
    """Points on the surface."""
    return from_depths(scene.depths, pictures(scene), *cameras(scene), count, np.random.default_rng(5)).xyz


def test_a_model_of_too_few_points_is_filled_up_where_the_scene_is(scene: Any) -> None:
    sparse = model(scene, 85)
    first = from_model(sparse, pictures(scene), *cameras(scene), 500, np.random.default_rng(0))
    assert first.made_of == {"of the sparse model": 85, "between its points": 415}
    assert first.xyz.shape == first.colors.shape == (500, 3)
    np.testing.assert_allclose(first.xyz[:85], sparse)
    distance = scene.distance(first.xyz[85:])
    # The cameras are 1.6 away. Of as many points in the cube around what they look at, the median is 0.14 away.
    assert np.median(distance) < 0.03
    assert np.quantile(distance, 0.9) < 0.12


def test_points_behind_a_surface_do_not_pull_what_is_filled_in_away_from_it() -> None:
    """A screen at depth 1 before a wall at depth 3, of which the model has points behind the screen too."""
    rng, count = np.random.default_rng(2), 400
    screen = np.column_stack([rng.uniform(-0.5, 0.5, (count, 2)), np.ones(count)])
    wall = np.column_stack([rng.uniform(-2.9, 2.9, (4 * count, 2)), np.full(4 * count, 3.0)])
    K = np.array([[[SIZE / 2, 0, SIZE / 2], [0, SIZE / 2, SIZE / 2], [0, 0, 1.0]]])
    grey = np.full((1, SIZE, SIZE, 3), 0.5, np.float32)
    sparse = np.concatenate([screen, wall])
    filled = from_model(sparse, grey, np.eye(4)[None], K, len(sparse) + 2000, rng).xyz[len(sparse) :]
    sides = np.abs(filled[:, :2] / filled[:, 2:]).max(1)
    before, beside = filled[sides < 0.4, 2], filled[(sides > 0.6) & (sides < 0.9), 2]
    assert len(before) > 200
    assert np.mean(np.abs(before - 1) < 0.01) > 0.9  # 5 % if points behind the screen counted
    assert np.mean(np.abs(beside - 3) < 0.01) > 0.9


def test_a_model_that_no_view_sees_gives_way_to_the_pictures(scene: Any) -> None:
    behind = np.array([[-50.0, -50, 0], [-50, -51, 0], [-51, -50, 1]])
    first = from_model(behind, pictures(scene), *cameras(scene), 300, np.random.default_rng(0))
    assert first.made_of == {"of the sparse model": 3, "from a plane sweep": 297}
    assert first.xyz.shape == first.colors.shape == (300, 3)
    assert np.median(scene.distance(first.xyz[3:])) < 0.05


@pytest.mark.parametrize("electrons", [None, 20.0])
def test_pictures_alone_tell_where_the_surface_is_in_the_dark_too(scene: Any, electrons: float | None) -> None:
    images = pictures(scene)
    if electrons is not None:
        rng = np.random.default_rng(1)
        linear = images**2.2
        noisy = rng.poisson(electrons * linear / linear.mean()) + rng.normal(0, 2, linear.shape)
        images = np.clip(0.05 * noisy / electrons, 0, 1).astype(np.float32) ** (1 / 2.2)
        images = np.round(255 * images).astype(np.float32) / 255
    first = from_pictures(images, *cameras(scene), 800, np.random.default_rng(0))
    assert first.made_of == {"from a plane sweep": 800}
    distance = scene.distance(first.xyz)
    cube = np.median(scene.distance(_around_focus(cameras(scene)[0], 800, np.random.default_rng(0))))
    assert np.median(distance) < (0.02 if electrons is None else 0.04)
    assert np.median(distance) < cube / 5
    assert np.quantile(distance, 0.8) < 0.12


def test_points_from_pictures_have_the_colour_of_the_pixel_that_they_were_found_at(scene: Any) -> None:
    viewmats, Ks = cameras(scene)
    marked = np.random.default_rng(3).uniform(0, 1e-6, (VIEWS, SIZE, SIZE, 3)).astype(np.float32)  # every pixel its own
    images = pictures(scene) + marked
    first = from_pictures(images, viewmats, Ks, 100, np.random.default_rng(0))
    found = np.zeros(100, bool)
    for image, viewmat, K in zip(images, viewmats, Ks, strict=True):
        x, y = np.nan_to_num(project(first.xyz, viewmat, K)[0], nan=-1).T
        inside = (x >= 0) & (x < SIZE) & (y >= 0) & (y < SIZE)
        found[inside] |= (image[y[inside].astype(int), x[inside].astype(int)] == first.colors[inside]).all(1)
    assert found.mean() > 0.97  # rounding at the border of a pixel


def test_a_world_of_another_size_place_and_direction_gives_the_same_points(scene: Any) -> None:
    """Depths are tried in units of the cameras' own distances: nothing depends on the unit of length."""
    viewmats, Ks = cameras(scene)
    first = from_pictures(pictures(scene), viewmats, Ks, 200, np.random.default_rng(0))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    scale, move = 40.0, np.array([3.0, -7.0, 5.0])
    other = viewmats.copy()  # X' = scale turn X + move
    other[:, :3, :3] = viewmats[:, :3, :3] @ turn.T
    other[:, :3, 3] = scale * viewmats[:, :3, 3] - np.einsum("cij,j->ci", other[:, :3, :3], move)
    moved = from_pictures(pictures(scene), other, Ks, 200, np.random.default_rng(0))
    distance = np.linalg.norm(moved.xyz - (scale * first.xyz @ turn.T + move), axis=1)
    assert np.median(distance) < 1e-3 * scale


def test_between_points_inverse_depths_are_averaged_by_inverse_distance() -> None:
    viewmats, Ks = np.eye(4)[None], np.array([[[10.0, 0, 8], [0, 10.0, 6], [0, 0, 1]]])
    at, z = np.array([[2.0, 3.0], [14.0, 9.0]]), np.array([1.0, 5.0])
    seen = unproject(at, z, np.repeat(viewmats, 2, 0), np.repeat(Ks, 2, 0))
    xyz, colors = fill([seen], np.zeros((1, 12, 16, 3), np.float32), viewmats, Ks, 50, np.random.default_rng(0))
    pixels, depth = project(xyz, viewmats[0], Ks[0])
    near = 1 / np.linalg.norm(pixels[:, None] - at, axis=-1)
    np.testing.assert_allclose(1 / depth, (near / z).sum(1) / near.sum(1), rtol=1e-9)
    assert colors.shape == (50, 3)


@pytest.mark.parametrize("scale", [1e-8, 1e8])
def test_a_model_in_other_units_is_filled_up_and_coloured_alike(scene: Any, scale: float) -> None:
    viewmats, Ks = cameras(scene)
    small = viewmats.copy()
    small[:, :3, 3] *= scale
    one, other = (
        from_model(unit * model(scene, 60), pictures(scene), mats, Ks, 200, np.random.default_rng(0))
        for unit, mats in ((1.0, viewmats), (scale, small))
    )
    np.testing.assert_allclose(other.xyz / scale, one.xyz, atol=1e-6)
    np.testing.assert_allclose(other.colors, one.colors, atol=1e-6)


def uneven(count: int, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pictures whose every pixel has a colour of its own, and cameras near the origin with pixels that are not square.

    They look along z, a little turned, each with intrinsics of its own.
    """
    rng = np.random.default_rng(7)
    viewmats, Ks = np.tile(np.eye(4), (count, 1, 1)), np.tile(np.eye(3), (count, 1, 1))
    viewmats[:, :3, :3] = Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))).as_matrix()
    viewmats[:, :3, 3] = 0.2 * rng.standard_normal((count, 3))
    Ks[:, 0, 0], Ks[:, 1, 1] = rng.uniform(12, 14, count), rng.uniform(8, 9, count)
    Ks[:, 0, 2], Ks[:, 1, 2] = width / 2 + 0.7, height / 2 - 0.4
    return rng.random((count, height, width, 3), np.float32), viewmats, Ks


def test_points_from_depth_are_behind_the_pixels_whose_colours_they_have() -> None:
    images, viewmats, Ks = uneven(3, 11, 6)
    depths = np.random.default_rng(8).uniform(1, 3, images.shape[:3])
    depths[:, :2, 5:] = np.inf
    first = from_depths(depths, images, viewmats, Ks, 90, np.random.default_rng(0))
    seen = set()
    for point, color in zip(first.xyz, first.colors, strict=True):
        ((view, y, x),) = np.argwhere((images == color).all(-1))
        pixels, z = project(point[None], viewmats[view], Ks[view])
        np.testing.assert_allclose(pixels, [[x + 0.5, y + 0.5]], atol=1e-9)
        np.testing.assert_allclose(z, depths[view, y, x])
        seen.add((view, y, x))
    assert len(seen) == 90
    assert {view for view, _, _ in seen} == {0, 1, 2}


def test_a_point_has_the_mean_colour_of_the_pixels_that_show_it() -> None:
    images, viewmats, Ks = uneven(4, 11, 6)
    points = np.random.default_rng(9).uniform([-1.6, -1.6, -1], [1.6, 1.6, 3], (200, 3))
    shown = []
    for point, found in zip(points, seen_colors(points, images, viewmats, Ks), strict=True):
        colors = []
        for image, viewmat, K in zip(images, viewmats, Ks, strict=True):
            x, y, z = K @ (viewmat[:3, :3] @ point + viewmat[:3, 3])
            if z > 0 and 0 <= x / z < 11 and 0 <= y / z < 6:
                colors.append(image[int(y / z), int(x / z)])
        shown.append(len(colors))
        np.testing.assert_allclose(found, np.mean(colors, 0) if colors else images.mean((0, 1, 2)), rtol=1e-5)
    assert set(shown) == {0, 1, 2, 3, 4}


def test_points_of_pictures_larger_than_what_is_compared_are_on_the_surface(corner: MakeCorner) -> None:
    """150 x 90 px become 64 x 38: not by the same factor in both directions."""
    scene = corner(4, 150, 90)
    first = from_pictures(pictures(scene), *cameras(scene), 300, np.random.default_rng(0))
    assert np.median(scene.distance(first.xyz)) < 0.025
    own = np.zeros((4, 300), bool)
    for view, (image, viewmat, K) in enumerate(zip(pictures(scene), *cameras(scene), strict=True)):
        x, y = np.nan_to_num(project(first.xyz, viewmat, K)[0], nan=-1).T
        inside = (x >= 0) & (x < 150) & (y >= 0) & (y < 90)
        own[view, inside] = (image[y[inside].astype(int), x[inside].astype(int)] == first.colors[inside]).all(1)
    assert own.any(0).mean() > 0.97  # rounding at the border of a pixel
    assert own.mean(1).min() > 0.15  # a quarter is from each view, with a standard error of 0.025


def test_pictures_that_show_nothing_still_give_points_in_front_of_the_cameras(scene: Any) -> None:
    viewmats, Ks = cameras(scene)
    first = from_pictures(
        np.full((VIEWS, SIZE, SIZE, 3), 0.02, np.float32), viewmats, Ks, 100, np.random.default_rng(0)
    )
    assert first.xyz.shape == (100, 3)
    _, depth = scene.rig.project(first.xyz)
    assert ((depth > 0).sum(0) >= 2).all()


def test_more_points_than_pixels_lie_on_the_surface_and_differ(scene: Any) -> None:
    viewmats, Ks = cameras(scene)
    coarse = np.full_like(scene.depths[:2], np.inf)
    coarse[:, 10:14, 10:14] = scene.depths[:2, 10:14, 10:14]
    first = from_depths(coarse, pictures(scene)[:2], viewmats[:2], Ks[:2], 200, np.random.default_rng(0))
    assert first.made_of == {"from depth": 200}
    assert len(np.unique(first.xyz.round(9), axis=0)) == 200
    assert scene.distance(first.xyz).max() < 0.05  # half a pixel of a slanted wall


def problem(scene: Any, first: FirstPoints, wanted: int | None) -> Problem:
    viewmats, Ks = (torch.tensor(a[1:], dtype=torch.float32) for a in cameras(scene))
    images = torch.from_numpy(pictures(scene)[1:])

    @dataclasses.dataclass
    class Start:
        points: torch.Tensor
        colors: torch.Tensor
        extent: float

    start = Start(torch.tensor(first.xyz, dtype=torch.float32), torch.tensor(first.colors, dtype=torch.float32), 1.0)
    views = Views(viewmats, Ks, SIZE, SIZE)
    return Problem(views=views, start=start, seed=0, srgb8=images, clean=images, n_gaussians=wanted)


def held_out(scene: Any, given: Problem) -> float:
    """Aligned PSNR of view 0 by the oracle."""
    config = METHODS["oracle"].config()
    short = FitConfig(iterations=150, sh_degree=0, mcmc=McmcConfig(refine_start=20, refine_every=20))
    config = dataclasses.replace(config, init_scale=0.7, fit=short)
    result = METHODS["oracle"].train(given, config)
    viewmats, Ks = (torch.tensor(a[:1], dtype=torch.float32) for a in cameras(scene))
    found = aligned_psnr(result.render(Views(viewmats, Ks, SIZE, SIZE))[0][0].numpy(), pictures(scene)[0])
    assert found is not None
    return found


def test_the_oracle_of_a_filled_model_is_two_decibels_above_that_of_its_own_points(scene: Any) -> None:
    """Rationale: with 60 Gaussians "the ceiling" was a smear below the methods it should bound."""
    viewmats, Ks = cameras(scene)
    args = (model(scene, 60), pictures(scene)[1:], viewmats[1:], Ks[1:])
    before = held_out(scene, problem(scene, from_model(*args, 60, np.random.default_rng(0)), None))
    after = held_out(scene, problem(scene, from_model(*args, 1500, np.random.default_rng(0)), 1500))
    assert after > before + 2.0


def test_the_population_grows_to_the_number_asked_for_where_fewer_points_came(scene: Any) -> None:
    first = from_model(model(scene, 60), pictures(scene), *cameras(scene), 60, np.random.default_rng(0))
    given = problem(scene, first, 150)
    config = FitConfig(iterations=60, sh_degree=0, mcmc=McmcConfig(refine_start=0, refine_every=4, growth=1.2))
    assert fit_for(given, config).cap_max == 150
    assert fit_for(given, dataclasses.replace(config, cap_max=100)).cap_max == 100
    assert fit_for(dataclasses.replace(given, n_gaussians=60), config).cap_max is None
    start = start_gaussians(given.start, given.srgb8, given.srgb8, sh_degree=0, init_scale=0.7)
    result = fit(start, given.views, lambda i: given.srgb8[i], fit_for(given, config))
    assert len(result.gaussians) == 150
