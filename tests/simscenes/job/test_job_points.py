"""Sparse points of a plane seen by a few cameras, against rays and projections written out one by one."""

from typing import Any

import numpy as np
import pytest

from simscenes import Rig, orbit_rig
from simscenes.job.sparse import surface_points

RIG = orbit_rig(3, 9, 7, 30, target=(0, 0, 0), radius=4.0, elevation_deg=60, swing_deg=5)


def on_the_floor(rig: Rig, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the pixel centres of view `i` show the plane z = 0 [h,w,3], and at which z-depth [h,w]; none in row 2."""
    c2w, K = np.linalg.inv(rig.viewmats[i]), rig.Ks[i]
    places, depths = np.zeros((rig.height, rig.width, 3)), np.full((rig.height, rig.width), np.inf)
    for y in range(rig.height):
        for x in range(rig.width):
            ray = c2w[:3, :3] @ np.linalg.solve(K, [x + 0.5, y + 0.5, 1.0])  # of z-depth 1
            if y != 2:
                depths[y, x] = -c2w[2, 3] / ray[2]
                places[y, x] = c2w[:3, 3] + depths[y, x] * ray
    return places, depths


def picture(i: int) -> Any:
    """A view whose colours tell view, row and column."""
    y, x = np.mgrid[:7, :9]
    return np.stack([np.full_like(x, i), y, x], -1).astype(np.uint8)


def seen(rig: Rig, j: int, point: np.ndarray) -> bool:
    """Whether a point of the empty floor appears in view `j`, below a row that shows nothing at all."""
    local = rig.viewmats[j] @ [*point, 1.0]
    x, y = (rig.Ks[j] @ local[:3])[:2] / local[2]
    return bool(local[2] > 0 and 0 <= x < rig.width and 0 <= y < rig.height)


@pytest.mark.parametrize("n_points", [1, 7, 40, 4000])
def test_points_are_drawn_from_all_views_and_kept_if_two_see_them(n_points: int) -> None:
    floors = [on_the_floor(RIG, i) for i in range(3)]
    rng, places, colors = np.random.default_rng([11, 3]), [], []
    for i, (place, depth) in enumerate(floors):
        order = rng.permutation(np.flatnonzero(np.isfinite(depth)))
        for pixel in order[: -int(-1.3 * n_points // 3)]:
            places.append(place.reshape(-1, 3)[pixel])
            colors.append([i, *np.divmod(pixel, 9)])
    visible = np.array([[seen(RIG, j, point) for point in places] for j in range(3)])
    kept = [k for k in range(len(places)) if visible[:, k].sum() >= 2]
    kept = sorted(rng.permutation(kept)[:n_points].tolist())
    xyz, rgb, by = surface_points(RIG, lambda i: floors[i][1], picture, seed=11, n_points=n_points)
    assert len(xyz) == min(n_points, len(kept)) > 0
    assert np.allclose(xyz, np.array(places)[kept], atol=1e-9)
    assert np.array_equal(rgb, np.array(colors)[kept])
    assert np.array_equal(by, visible[:, kept])


def test_of_a_single_view_all_points_count() -> None:
    alone = Rig(viewmats=RIG.viewmats[:1], Ks=RIG.Ks[:1], width=9, height=7)
    xyz, _, by = surface_points(alone, lambda i: on_the_floor(alone, i)[1], picture, seed=0, n_points=20)
    assert len(xyz) == 20
    assert by.all()
    assert np.abs(xyz[:, 2]).max() < 1e-9
