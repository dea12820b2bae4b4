"""Claims about pictures that do not show what their cameras say: said of all or of one, and of right ones not."""

import cv2
import numpy as np
import pytest

from novags.cameras.matching import picture_doubts
from simscenes import orbit_rig

COUNT, WIDTH, HEIGHT = 12, 240, 180
RIG = orbit_rig(COUNT, WIDTH, HEIGHT, 45.0, radius=3.0, elevation_deg=55.0, sweep_deg=120.0)
VIEWMATS = np.asarray(RIG.viewmats)
NAMES = [f"{i:02d}" for i in range(COUNT)]
HALF = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # OpenCV counts pixel centres from 0


def painted_ground() -> list[np.ndarray]:
    """Every view of a ground of blobs of several sizes."""
    rng, paint = np.random.default_rng(0), np.zeros((800, 800, 3))
    for cells in (16, 40, 90):
        paint += cv2.resize(rng.random((cells, cells, 3)), (800, 800), interpolation=cv2.INTER_CUBIC)
    codes = (255 * (paint - paint.min()) / np.ptp(paint)).astype(np.uint8)
    place = np.array([[5 / 800, 0, -2.5], [0, 5 / 800, -2.5], [0, 0, 1]])  # of a texel on the ground, z = 0
    return [
        cv2.warpPerspective(codes, HALF @ K @ V[:3, [0, 1, 3]] @ place, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        for V, K in zip(VIEWMATS, RIG.Ks, strict=True)
    ]


PICTURES = painted_ground()


def doubts(viewmats: np.ndarray = VIEWMATS, pictures: list[np.ndarray] = PICTURES, focal: float = 1.0) -> list[str]:
    Ks = np.asarray(RIG.Ks) @ np.diag([focal, focal, 1.0])
    return picture_doubts(NAMES, viewmats, Ks, lambda i: pictures[i])


def test_right_cameras_raise_no_doubt_in_dim_noisy_and_bare_pictures_either() -> None:
    rng = np.random.default_rng(1)
    assert doubts() == []
    assert doubts(pictures=[(p // 10 + rng.integers(0, 2, p.shape)).astype(np.uint8) for p in PICTURES]) == []
    assert doubts(pictures=[rng.integers(0, 9, p.shape).astype(np.uint8) for p in PICTURES]) == []
    assert doubts(pictures=[np.full_like(p, 9) for p in PICTURES]) == []


TURNED = np.diag([1.0, -1, -1, 1])


@pytest.mark.parametrize(
    ("viewmats", "pictures"),
    [
        (TURNED @ VIEWMATS, PICTURES), (np.linalg.inv(VIEWMATS), PICTURES), (np.roll(VIEWMATS, 1, 0), PICTURES),
        (VIEWMATS, [p[:, ::-1] for p in PICTURES]),
    ],
    ids=["axes of OpenCV", "world to camera", "the next picture", "mirrored"],
)  # fmt: skip
def test_cameras_of_another_convention_and_pictures_of_others_are_said(
    viewmats: np.ndarray, pictures: list[np.ndarray]
) -> None:
    (note,) = doubts(viewmats, [np.ascontiguousarray(p) for p in pictures])
    assert note.startswith("pictures do not show what their cameras say: points that two of them share lie ")


@pytest.mark.parametrize(("focal", "right"), [(2.0, "0.5"), (1.25, "0.8"), (0.6, "1.7")])
def test_a_wrong_focal_length_is_said_with_what_fits_better(focal: float, right: str) -> None:
    (note,) = doubts(focal=focal)
    assert f"fit better with {right} times the focal length" in note
    assert doubts(focal=1.02) == []


def test_one_picture_that_is_turned_is_named() -> None:
    pictures = list(PICTURES)
    pictures[7] = np.ascontiguousarray(pictures[7][::-1, ::-1])
    (note,) = doubts(pictures=pictures)
    assert note.startswith("1 of 12 pictures that were looked at do not show what their cameras say: 07;")
