"""Claims about lenses with distortion: pixels of an undistorted picture show what their rays see, also at a turn."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from simscenes import load_set
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.lens import MOST_FOLDED, DistortedPinhole, distorted, turning
from tests.simscenes.sets.readers.test_entries import folder_of

W, H = 160, 120


def colour(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth picture on the plane z = 1: the right value of any ray."""
    waves = [np.sin(2.1 * x + 0.3), np.sin(1.7 * y - 0.2), np.cos(1.3 * (x + y))]
    return 128 + 90 * np.stack(waves, -1)


def lens_of(focal: float, *distortion: float) -> DistortedPinhole:
    k1, k2, p1, p2, k3 = (*distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    K = np.array([[focal, 0, W / 2 + 3], [0, 1.02 * focal, H / 2 - 2], [0, 0, 1]])
    return DistortedPinhole(K, (k1, k2, p1, p2, k3))


def photograph(lens: DistortedPinhole) -> tuple[np.ndarray, np.ndarray]:
    """What the lens shows, float [h,w,3], and where it shows something [h,w].

    Each pixel is looked up among rays before the turn, on a fine grid of radius and direction, and polished by Newton.
    """
    v, u = np.mgrid[0.5:H, 0.5:W]
    wanted = np.stack([(u - lens.K[0, 2]) / lens.K[0, 0], (v - lens.K[1, 2]) / lens.K[1, 1]], -1).reshape(-1, 2)
    turn = turning(lens.distortion)
    angles = np.arange(0, 2 * np.pi, 2 * np.pi / 720)
    most = np.interp(angles, np.arange(len(turn)) * 2 * np.pi / len(turn), np.minimum(turn, 4.0), period=2 * np.pi)
    radii = np.linspace(0.002, 0.999, 500)[:, None] * most
    grid = np.stack([radii * np.cos(angles), radii * np.sin(angles)], -1).reshape(-1, 2)
    from scipy.spatial import cKDTree

    away, near = cKDTree(distorted(grid, lens.distortion)).query(wanted)
    rays = grid[near]
    for _ in range(8):
        wrong = distorted(rays, lens.distortion) - wanted
        h = 1e-6
        dx = (distorted(rays + [h, 0], lens.distortion) - distorted(rays, lens.distortion)) / h
        dy = (distorted(rays + [0, h], lens.distortion) - distorted(rays, lens.distortion)) / h
        step = np.linalg.solve(np.stack([dx, dy], -1) + 1e-12 * np.eye(2), wrong[..., None])[..., 0]
        rays = rays - np.clip(step, -0.02, 0.02)
    shown = (np.abs(distorted(rays, lens.distortion) - wanted).max(-1) < 1e-5) & (away < 0.05)
    return np.where(shown[:, None], colour(*rays.T), 0).reshape(H, W, 3), shown.reshape(H, W)


@pytest.mark.parametrize(
    "lens",
    [
        lens_of(120, -0.1), lens_of(130, 0.06), lens_of(90, -0.25, 0.05), lens_of(60, -0.27, 0.07),
        lens_of(50, -0.27, 0.05), lens_of(60, 0.6, 0.2), lens_of(110, -0.27), lens_of(112, -0.26, 0, 0.01, -0.008),
        lens_of(100, -0.2, 0.02, 0.004, 0.003, -0.02),
    ],
    ids=lambda lens: f"f{lens.K[0, 0]:g}-{lens.distortion}",
)  # fmt: skip
def test_every_pixel_of_an_undistorted_picture_is_what_its_ray_sees(lens: DistortedPinhole) -> None:
    """Rationale: OpenCV's own choice of a pinhole leaves black corners, or a folded ring, for wide lenses."""
    picture, _ = photograph(lens)
    pinhole = lens.pinhole(W, H)
    got = lens.undistort(picture.round().astype(np.uint8), pinhole).astype(float)
    v, u = np.mgrid[0.5:H, 0.5:W]
    right = colour((u - pinhole[0, 2]) / pinhole[0, 0], (v - pinhole[1, 2]) / pinhole[1, 1])
    error = np.abs(got - right).max(-1)
    assert np.median(error) < 1
    # Interpolation at the border and where a turn draws pixels out; a fold or a black corner is 50 codes and more.
    assert (error > 12).mean() < 0.004, (error > 12).mean()


@pytest.mark.parametrize("lens", [lens_of(120, -0.1), lens_of(130, 0.06), lens_of(60, -0.27, 0.07)])
def test_the_pinhole_is_the_widest_that_shows_no_border(lens: DistortedPinhole) -> None:
    pinhole = lens._inscribed(W, H)
    wider = pinhole * [[0.999, 1, 1], [1, 0.999, 1], [1, 1, 1]]
    assert lens._shows(pinhole, W, H, 0.0)
    assert not lens._shows(wider, W, H, 0.0)


@pytest.mark.parametrize("lens", [lens_of(80, -0.27), lens_of(70, -0.3), lens_of(80, -0.2, 0, 0.02, 0.01, -0.05)])
def test_a_lens_whose_polynomial_turns_well_inside_the_picture_is_refused_with_its_share(
    lens: DistortedPinhole,
) -> None:
    share = 1 - photograph(lens)[1].mean()
    assert lens.folded(W, H) == pytest.approx(share, abs=0.02)
    assert share > MOST_FOLDED
    with pytest.raises(
        ValueError, match=rf"k1 = -0.{str(lens.distortion[0])[3:]}.* turns \d+ px .*{lens.folded(W, H):.0%}"
    ):
        lens.pinhole(W, H)


def test_the_turn_of_a_radial_polynomial_is_where_it_stops_growing() -> None:
    assert turning((-0.27, 0.0, 0.0, 0.0, 0.0))[0] == pytest.approx(1 / np.sqrt(3 * 0.27))
    assert np.isinf(turning((-0.27, 0.07, 0.0, 0.0, 0.0))).all()
    assert turning((0.1, 0.0, 0.0, 0.0, -0.01))[5] == pytest.approx(
        np.sqrt(np.roots([-0.07, 0, 0.3, 1]).real.max()), rel=1e-9
    )


def test_tangential_terms_move_the_turn_with_the_direction() -> None:
    """Where the determinant of the derivative, by differences, is 0."""
    terms = (-0.2, 0.01, 0.03, -0.02, 0.0)
    turn = turning(terms)
    angle = np.arange(len(turn)) * 2 * np.pi / len(turn)
    rays = turn[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    h = 1e-5
    dx = (distorted(rays + [h, 0], terms) - distorted(rays - [h, 0], terms)) / (2 * h)
    dy = (distorted(rays + [0, h], terms) - distorted(rays - [0, h], terms)) / (2 * h)
    np.testing.assert_allclose(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0], 0, atol=1e-8)


def test_a_small_share_beyond_the_turn_is_cut_off_and_said(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    for i in range(3):
        write_png(folder / f"{i}.png", np.zeros((H, W, 3), np.uint8))
    content = json.loads((folder / "transforms.json").read_text())
    content |= {"fl_x": 110.0, "fl_y": 110.0, "k1": -0.27, "cx": W / 2, "cy": H / 2, "w": W, "h": H}
    (folder / "transforms.json").write_text(json.dumps(content))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_set(folder)
    (note,) = [str(w.message) for w in caught]
    assert "turns 81 px from the centre of the picture: up to 8.6% of each picture lies beyond" in note
