from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from novags.cameras.align import align
from novags.cameras.known import known, perturb
from novags.cameras.sources.known import KnownConfig
from simscenes.rigs import Rig, orbit_rig
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.multiview import load_set

SIZE = 20


@dataclass(frozen=True)
class FakeSet:
    """The part of a MultiviewSet that `known` looks at: cameras around a plane z = 0, or around nothing known."""

    rig: Rig
    depth: bool = True
    sparse: SparsePoints | None = None

    def geometry(self, i: int) -> dict[str, Any] | None:
        if not self.depth:
            return None
        y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(self.rig.Ks[i]).T
        rotation = self.rig.viewmats[i, :3, :3]
        down = rays @ rotation[:, 2]
        center = -rotation.T @ self.rig.viewmats[i, :3, 3]
        with np.errstate(divide="ignore"):
            z = np.where(down < 0, -center[2] / down, np.inf)
        return {"z": z.astype(np.float32)}

    def points(self) -> SparsePoints | None:
        return self.sparse


def cameras(count: int = 4) -> Rig:
    return orbit_rig(count, SIZE, SIZE, 50.0, radius=3.0, elevation_deg=35.0)


def shaded(count: int = 4) -> torch.Tensor:
    """Images whose colour says which view they are."""
    return torch.arange(count).reshape(-1, 1, 1, 1).expand(count, SIZE, SIZE, 3) / 10


def test_points_from_depth_lie_on_the_surface_and_see_the_dark_colours():
    multiview = FakeSet(cameras())
    start = known(multiview, [1, 2], torch.full((2, SIZE, SIZE, 3), 0.07), n_points=300, seed=0)
    assert start.points.shape == start.colors.shape == (300, 3)
    assert start.points.dtype == start.colors.dtype == torch.float32
    assert start.viewmats.dtype == start.Ks.dtype == torch.float64
    assert start.points[:, 2].abs().max() < 1e-5
    torch.testing.assert_close(start.colors, torch.full((300, 3), 0.07))
    assert start.registered == (0, 1)
    np.testing.assert_array_equal(start.viewmats.numpy(), multiview.rig.viewmats[[1, 2]])
    np.testing.assert_array_equal(start.Ks.numpy(), multiview.rig.Ks[[1, 2]])
    # Every point comes from a pixel centre of one of the two views, and is in frame there.
    from_centre = []
    for viewmat, K in zip(start.viewmats, start.Ks, strict=True):
        pixels = (start.points.double() @ viewmat[:3, :3].T + viewmat[:3, 3]) @ K.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        off = (pixels - 0.5 - (pixels - 0.5).round()).abs().amax(1)
        from_centre.append((off < 1e-3) & ((pixels > 0) & (pixels < SIZE)).all(1))
    assert (from_centre[0] | from_centre[1]).all()


@pytest.mark.parametrize("indices", [[0, 1], [1, 0]])
def test_one_view_of_any_surface_is_enough_for_points_from_depth(indices):
    """View 0 looks up into nothing, whether it comes first or last."""
    rig = cameras()
    viewmats = rig.viewmats.copy()
    viewmats[0, :3] = np.diag([1.0, -1.0, -1.0]) @ viewmats[0, :3]  # turned round its x axis
    multiview = FakeSet(replace(rig, viewmats=viewmats))
    assert not np.isfinite(multiview.geometry(0)["z"]).any()
    assert known(multiview, indices, shaded(2), n_points=50).points[:, 2].abs().max() < 1e-5


def test_the_seed_chooses_the_points():
    multiview = FakeSet(cameras())
    a, b, c = (known(multiview, [0, 1, 2, 3], shaded(), n_points=50, seed=seed).points for seed in (0, 0, 1))
    assert torch.equal(a, b)
    assert not torch.equal(a, c)


def test_fewer_pixels_than_points_give_every_pixel_and_places_between_them():
    multiview = FakeSet(cameras())
    start = known(multiview, [0], shaded(1), n_points=1000)
    shown = int(np.isfinite(multiview.geometry(0)["z"]).sum())
    assert shown <= SIZE * SIZE < len(start.points) == 1000
    centre = start.points.double() @ start.viewmats[0, :3, :3].T + start.viewmats[0, :3, 3]
    pixels = (centre @ start.Ks[0].T)[:, :2] / centre[:, 2:]
    in_the_middle = ((pixels % 1 - 0.5).abs() < 1e-3).all(1)
    assert in_the_middle[:shown].all()
    assert not in_the_middle[shown:].all()


def test_colours_are_averaged_over_neighbours():
    noisy = 0.1 + 0.05 * torch.randn(4, SIZE, SIZE, 3, generator=torch.Generator().manual_seed(0))
    colors = known(FakeSet(cameras()), [0, 1, 2, 3], noisy, n_points=1000).colors
    # Means of 8: a third of the deviation. 1000 points share neighbours; 20 % covers that.
    assert float(colors.std()) == pytest.approx(0.05 / 8**0.5, rel=0.2)


def test_depth_errors_scale_the_depth_of_each_view_as_a_whole():
    multiview = FakeSet(cameras())
    start = known(multiview, [2], shaded(1), n_points=400, config=KnownConfig(depth_error=0.3), seed=1)
    inside = start.points.double() @ start.viewmats[0, :3, :3].T + start.viewmats[0, :3, 3]
    pixels = inside @ start.Ks[0].T
    column, row = (pixels[:, :2] / pixels[:, 2:]).T
    true = torch.from_numpy(multiview.geometry(2)["z"])[row.long(), column.long()]
    factors = inside[:, 2] / true
    assert float(factors.std()) < 1e-5
    assert abs(float(factors.mean()) - 1) > 0.05


def test_depth_errors_of_the_views_are_independent_and_of_the_stated_size():
    multiview, logs = FakeSet(cameras()), []
    config = KnownConfig(depth_error=0.1)
    for seed in range(60):
        start = known(multiview, [0, 1], shaded(2), n_points=200, seed=seed, config=config)
        factors = []
        for i in (0, 1):
            viewmat, K = start.viewmats[i], start.Ks[i]
            inside = start.points.double() @ viewmat[:3, :3].T + viewmat[:3, 3]
            pixels = inside @ K.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            own = ((pixels % 1 - 0.5).abs() < 1e-3).all(1) & ((pixels > 0) & (pixels < SIZE)).all(1)
            column, row = pixels[own].long().T
            true = torch.from_numpy(multiview.geometry(i)["z"])[row, column]
            factors.append(float((inside[own, 2] / true).median()))
        logs.append(np.log(factors))
    first, second = np.array(logs).T
    assert np.std(np.array(logs)) == pytest.approx(0.1, rel=0.3)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.5  # of 60: four standard errors


def test_perturbations_have_the_stated_root_mean_square():
    exact = orbit_rig(2000, SIZE, SIZE, 50.0, radius=3.0).viewmats
    moved = perturb(exact, 2.0, 0.1, np.random.default_rng(0))
    turns = Rotation.from_matrix(moved[:, :3, :3] @ exact[:, :3, :3].transpose(0, 2, 1)).magnitude()
    centers = [-np.einsum("cji,cj->ci", v[:, :3, :3], v[:, :3, 3]) for v in (exact, moved)]
    shifts = np.linalg.norm(centers[1] - centers[0], axis=1)
    # Squares of three-dimensional normals: relative sd sqrt(2/3), of the mean over 2000 1.8 %, of its root 0.9 %.
    assert np.degrees(np.sqrt((turns**2).mean())) == pytest.approx(2.0, rel=0.046)
    assert np.sqrt((shifts**2).mean()) == pytest.approx(0.1, rel=0.046)
    np.testing.assert_allclose(
        moved[:, :3, :3] @ moved[:, :3, :3].transpose(0, 2, 1), np.eye(3)[None].repeat(2000, 0), atol=1e-12
    )
    np.testing.assert_allclose(perturb(exact, 0.0, 0.0, np.random.default_rng(0)), exact, atol=1e-14)


def test_cameras_are_wrong_by_the_stated_errors_and_the_extent_is_the_true_one():
    multiview, config = FakeSet(cameras(40)), KnownConfig(rotation_deg=2.0, translation=0.05)
    exact, moved = (
        known(multiview, list(range(40)), shaded(40), n_points=50, config=c, seed=3) for c in (KnownConfig(), config)
    )
    assert moved.extent == exact.extent
    found = align(moved.viewmats, exact.viewmats)
    # 120 normal numbers: relative sd of the root mean square 1 / sqrt(240); the alignment takes 7 of 240 away.
    assert float(found.rotation_deg.square().mean().sqrt()) == pytest.approx(2.0, rel=0.35)
    assert float(found.centre_error.square().mean().sqrt()) == pytest.approx(0.05, rel=0.35)


def test_points_follow_the_perturbed_cameras():
    multiview = FakeSet(cameras())
    exact = known(multiview, [0], shaded(1), n_points=10_000)
    moved = known(multiview, [0], shaded(1), n_points=10_000, config=KnownConfig(rotation_deg=3.0, translation=0.2))

    def seen(start) -> torch.Tensor:
        return start.points.double() @ start.viewmats[0, :3, :3].T + start.viewmats[0, :3, 3]

    torch.testing.assert_close(seen(moved), seen(exact), atol=1e-5, rtol=0)
    assert not torch.allclose(moved.points, exact.points, atol=1e-2)


def test_without_depth_sparse_points_are_taken_but_never_their_lit_colours():
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3))
    lit = np.full((200, 3), 255, np.uint8)
    start = known(
        FakeSet(cameras(), depth=False, sparse=SparsePoints.untracked(points, lit)),
        [0, 1],
        shaded(2) + 0.02,
        n_points=100,
    )
    assert len(start.points) == 100
    distance = (start.points[:, None].double() - torch.from_numpy(points)[None]).norm(dim=-1).min(1).values
    assert distance.max() < 1e-6
    # Every point is in both frames, whose colours are 0.02 and 0.12.
    torch.testing.assert_close(start.colors, torch.full((100, 3), 0.07))


def test_points_of_a_sparse_model_stay_exact_while_cameras_are_wrong():
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (60, 3))
    multiview = FakeSet(cameras(), depth=False, sparse=SparsePoints.untracked(points, np.zeros((60, 3), np.uint8)))
    start = known(multiview, [0, 1], shaded(2), n_points=60, config=KnownConfig(rotation_deg=3.0, translation=0.2))
    assert not np.allclose(start.viewmats, multiview.rig.viewmats[[0, 1]], atol=1e-2)
    np.testing.assert_allclose(start.points, points, atol=1e-6)


@pytest.mark.parametrize("sparse", [None, SparsePoints.untracked(np.zeros((3, 3)), np.zeros((3, 3), np.uint8))])
def test_depth_errors_of_a_set_without_depth_are_refused(sparse: SparsePoints | None):
    with pytest.raises(ValueError, match=r"depth_error .* needs a set with depth.*got 0.2 and no depth: leave it out"):
        known(FakeSet(cameras(), depth=False, sparse=sparse), [0, 1], shaded(2), n_points=50,
              config=KnownConfig(depth_error=0.2))  # fmt: skip


def test_pictures_that_share_no_neighbours_start_at_random_where_the_cameras_look():
    """Four cameras a quarter of a circle apart: no two of them look the same way."""
    start = known(FakeSet(cameras(), depth=False), [0, 1, 2, 3], shaded(), n_points=500)
    assert start.made_of == {"at random": 500}
    # Half the distance of the cameras from what they look at; the ridge moves the centre by a thousandth.
    assert start.points.abs().max() <= 1.5 + 5e-3
    assert start.points.std(0).min() > 0.7


@pytest.mark.parametrize("count", [1, 3])
def test_parallel_and_single_cameras_still_give_finite_points(count):
    viewmats = np.repeat(np.eye(4)[None], count, 0)
    viewmats[:, 0, 3] = np.arange(count)
    rig = Rig(viewmats=viewmats, Ks=cameras(count).Ks if count > 1 else cameras(2).Ks[:1], width=SIZE, height=SIZE)
    start = known(FakeSet(rig, depth=False), list(range(count)), shaded(count), n_points=50)
    assert torch.isfinite(start.points).all()
    assert torch.isfinite(start.colors).all()


def test_impossible_requests_are_refused():
    with pytest.raises(ValueError, match="n_points must be >= 2, got 1"):
        known(FakeSet(cameras()), [0], shaded(1), n_points=1)


@pytest.mark.parametrize("name", ["rotation_deg", "translation", "depth_error"])
@pytest.mark.parametrize("value", [-0.1, float("inf"), float("nan")])
def test_impossible_errors_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} of known cameras must be finite and >= 0"):
        KnownConfig(**{name: value})


def test_images_of_another_number_or_size_are_refused():
    with pytest.raises(ValueError, match="colors_from"):
        known(FakeSet(cameras()), [0, 1], shaded(1), n_points=50)


def test_real_photographs_give_cameras_and_points_around_the_fox(fox):
    with pytest.warns(UserWarning, match="have no image"):
        multiview = load_set(fox)
    indices = multiview.train_indices[:4]
    images = torch.from_numpy(np.stack([multiview.image(i) for i in indices]).astype(np.float32) / 255)
    start = known(multiview, indices, 0.1 * images, n_points=300)
    assert 2 <= len(start.points) <= 300
    assert start.extent > 0
    assert torch.isfinite(start.points).all()
    assert 0 <= start.colors.min() <= start.colors.max() <= 0.1
