"""Claims about doubts in cameras: said of each camera that stands apart, of too little to go by, and else not."""

import cv2
import numpy as np
import pytest

from novags.cameras.doubts import camera_doubts, few_views, lens_doubts, same_photographs
from simscenes import orbit_rig
from simscenes.sets.pictures.mask import is_mask
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.bare import without_masks

COUNT = 10
VIEWMATS = np.array(orbit_rig(COUNT, 40, 30, 50.0, radius=3.0).viewmats)
LABELS = [f"{i}.jpg" for i in range(COUNT)]
FOCALS = np.full(COUNT, 1.1)
POINTS = np.random.default_rng(0).normal(0, 0.4, (900, 3))
SEEN = [400] * COUNT


def moved(factor: float) -> np.ndarray:
    """The cameras with the one at place 4 that many times as far from the origin."""
    viewmats = VIEWMATS.copy()
    viewmats[4, :3, 3] *= factor
    return viewmats


def test_good_cameras_raise_no_doubt() -> None:
    assert camera_doubts(LABELS, VIEWMATS, FOCALS, points=POINTS, seen=SEEN) == []
    assert camera_doubts(LABELS, VIEWMATS, FOCALS) == []
    assert camera_doubts(LABELS, moved(2.0), FOCALS * np.linspace(0.8, 1.2, COUNT), points=POINTS, seen=SEEN) == []
    lenses = np.where(np.arange(COUNT) % 2, 1.1, 2.4)  # half of the photographs by another lens
    assert camera_doubts(LABELS, VIEWMATS, lenses, points=POINTS, seen=SEEN) == []
    several = np.append(np.full(37, 1.1), [2.5, 2.52, 2.49])  # a rig with another lens on one of its cameras
    assert camera_doubts(LABELS * 4, np.tile(VIEWMATS, (4, 1, 1)), several) == []
    assert few_views(8) == []
    telephone = np.array([[[700, 0, 320], [0, f, 240], [0, 0, 1.0]] for f in (690, 720)])
    assert lens_doubts(telephone, (640, 480)) == []
    assert (
        lens_doubts(telephone * np.array([8.5, 8.5, 1])[:, None] - [[0, 0, 2400], [0, 0, 1800], [0, 0, 0]], (640, 480))
        == []
    )


def looking_ahead(centres: np.ndarray) -> np.ndarray:
    """Cameras at places [C,3] that all look along z."""
    viewmats = np.tile(np.eye(4), (len(centres), 1, 1))
    viewmats[:, :3, 3] = -centres
    return viewmats


def test_cameras_in_the_middle_of_a_walk_or_of_a_grid_stand_apart_from_nobody() -> None:
    """As of a video of 302 frames whose cameras pass the middle at a tenth of the usual distance."""
    walk = np.linspace(-3, 3, 61)[:, None] * [0.1, 0, 1]
    grid = np.stack(np.meshgrid(np.arange(7), np.arange(7), [0]), -1).reshape(-1, 3).astype(float)
    for centres in (walk, grid):
        labels, focals = [f"{i}" for i in range(len(centres))], np.full(len(centres), 0.9)
        assert camera_doubts(labels, looking_ahead(centres), focals) == []
        centres[7] *= 1e4
        (note,) = camera_doubts(labels, looking_ahead(centres), focals)
        assert note.startswith(f"1 of {len(centres)} cameras stand apart from the others: 7 (")


def test_close_ups_of_a_drone_stand_apart_from_nobody() -> None:
    """As of 75 photographs from the air, some of them from a quarter of the height."""
    circle, few = np.linspace(0, 2 * np.pi, 400, endpoint=False), np.linspace(0, 1.5, 4)
    angle, radius = np.append(circle, few), np.append(np.full(400, 3.0), np.full(4, 0.3))
    viewmats = np.tile(np.eye(4), (404, 1, 1))
    viewmats[:, :3, :3] = [[[-np.sin(a), np.cos(a), 0], [0, 0, -1], [-np.cos(a), -np.sin(a), 0]] for a in angle]
    viewmats[:, 2, 3] = radius
    assert camera_doubts([f"{i}" for i in range(404)], viewmats, np.full(404, 1.1)) == []


def test_a_camera_within_what_the_others_surround_stands_apart() -> None:
    viewmats = np.array(orbit_rig(80, 40, 30, 50.0, radius=3.0).viewmats)
    viewmats[4, :3, 3] /= 10
    (note,) = camera_doubts([f"{i}" for i in range(80)], viewmats, np.full(80, 1.1))
    assert note.startswith("1 of 80 cameras stand apart from the others: 4 (0.1 times as far from the scene)")


@pytest.mark.parametrize(
    ("fx", "fy", "said"),
    [
        (566.2, 840.3, "2 of 2 cameras have another focal length along x than along y, the worst 0.674 times it"),
        (1638.6, 904.5, "2 of 2 cameras have another focal length along x than along y, the worst 1.81 times it"),
        (166504, 166504, "2 of 2 cameras have a focal length of 163 to 163 times the longer side of the picture"),
        (60, 60, "2 of 2 cameras have a focal length of 0.0586 to 0.0586 times the longer side"),
    ],
)
def test_lenses_that_no_camera_has_are_said(fx: float, fy: float, said: str) -> None:
    """Calibrations of too few photographs as people publish them."""
    K = np.array([[fx, 0, 512], [0, fy, 384], [0, 0, 1.0]])
    (note,) = lens_doubts(np.stack([K, K]), (1024, 768))
    assert note.startswith(said)


@pytest.mark.parametrize(("cx", "cy"), [(0, 0), (0.5, 0.5), (320, 20), (600, 240)])
def test_a_principal_point_beside_the_middle_half_is_said(cx: float, cy: float) -> None:
    (note,) = lens_doubts(np.array([[[700, 0, cx], [0, 700, cy], [0, 0, 1.0]]]), (640, 480))
    assert note.startswith("1 of 1 cameras have their principal point beside the middle half of the picture")


def test_copies_of_a_photograph_are_said_by_name(tmp_path) -> None:
    files = [tmp_path / f"{i}.jpg" for i in range(4)]
    for i, file in enumerate(files):
        file.write_bytes(bytes([i]) * 1000)
    assert same_photographs(files) == []
    files[3].write_bytes(files[1].read_bytes())
    (note,) = same_photographs(files)
    assert note.startswith("1 of 4 photographs are copies of another one (3.jpg and 1.jpg)")
    (tmp_path / "test").mkdir()
    (tmp_path / "test" / "2.jpg").write_bytes(files[2].read_bytes())
    (note,) = same_photographs([files[2], tmp_path / "test" / "2.jpg"])
    assert f"(test/2.jpg and {tmp_path.name}/2.jpg)" in note


@pytest.mark.parametrize("known", [True, False])
def test_a_camera_far_from_the_others_with_another_lens_is_named_with_its_reasons(known: bool) -> None:
    """As of the photographs of a church: 38 points, a focal length twice and a distance ten times the others'."""
    focals, seen = FOCALS.copy(), list(SEEN)
    focals[4], seen[4] = 2.2, 38
    given = {"points": POINTS, "seen": seen} if known else {}
    (note,) = camera_doubts(LABELS, moved(10.0), focals, **given)
    assert note.startswith("1 of 10 cameras stand apart from the others: 4.jpg (")
    assert "times as far from the scene, focal length 2 times as long" in note
    assert ("38 points where others see 400" in note) == known


def test_too_few_points_too_few_views_and_a_camera_that_only_turns_are_said() -> None:
    (few,) = camera_doubts(LABELS[:5], VIEWMATS[:5], FOCALS[:5], points=POINTS[:82], seen=[30] * 5)
    assert few.startswith(
        "few points hold the cameras together: 82 in all, 30 in the median photograph, of at least 100"
    )
    turned = VIEWMATS.copy()
    turned[:, :3, 3] = np.einsum("cij,j->ci", -turned[:, :3, :3], [0, 0, 3.0])
    assert any(
        "taken from one place" in said for said in camera_doubts(LABELS, turned, FOCALS, points=POINTS, seen=SEEN)
    )
    assert any("taken from one place" in said for said in camera_doubts(LABELS, np.tile(np.eye(4), (10, 1, 1)), FOCALS))
    (note,) = few_views(5)
    assert note.startswith("only 5 photographs have a camera, at least 8 are of use")


@pytest.mark.parametrize("name", ["a_mask.png", "a.mask.png", "a.jpg.png", "masks/a.png", "whatever.png"])
def test_masks_are_told_from_photographs_by_name_place_or_content(name: str, tmp_path) -> None:
    rng = np.random.default_rng(0)
    photographs = [tmp_path / f"{stem}.jpg" for stem in "abc"]
    for file in photographs:
        cv2.imwrite(str(file), rng.integers(0, 255, (60, 80, 3), np.uint8))
    mask = np.zeros((60, 80, 3), np.uint8)
    mask[20:40] = 255
    write_png(tmp_path / name, mask)
    assert without_masks([*photographs, tmp_path / name]) == (photographs, [tmp_path / name])


def test_names_alone_do_not_make_masks(tmp_path) -> None:
    rng, files = np.random.default_rng(0), []
    for name in ("masks/a.png", "masks/b.png"):
        write_png(tmp_path / name, rng.integers(0, 255, (60, 80, 3), np.uint8))
        files.append(tmp_path / name)
    assert without_masks(files) == (files, [])
    write_png(tmp_path / "carnival_mask.png", rng.integers(0, 255, (60, 80, 3), np.uint8))
    write_png(tmp_path / "d.png", rng.integers(0, 255, (60, 80, 3), np.uint8))
    both = [tmp_path / "carnival_mask.png", tmp_path / "d.png"]
    assert without_masks(both) == (both, [])


def soft_disc(colour: tuple[int, int, int] = (255, 255, 255), share: float = 0.3) -> np.ndarray:
    """A disc with a soft edge on black [120,160,3]."""
    y, x = np.mgrid[:120, :160]
    inside = np.clip(40 * share / 0.3 - np.hypot(y - 60, x - 80) + 0.5, 0, 1)
    return np.round(inside[..., None] * np.array(colour)).astype(np.uint8)


def test_masks_are_told_from_their_pixels_in_jpeg_with_soft_edges_and_as_labels() -> None:
    labels = np.zeros((120, 160, 3), np.uint8)
    for k in range(12):
        labels[:, 13 * k : 13 * k + 13] = (20 * k, 255 - 20 * k, 77)
    kept, file = cv2.imencode(".jpg", soft_disc(), [cv2.IMWRITE_JPEG_QUALITY, 60])
    assert kept
    for mask in (soft_disc(), 255 - soft_disc(), soft_disc(share=0.1), labels, cv2.imdecode(file, cv2.IMREAD_COLOR)):
        assert is_mask(np.asarray(mask, np.uint8))


def test_dark_photographs_night_and_drawings_with_shades_are_no_masks() -> None:
    rng = np.random.default_rng(0)
    dark = rng.poisson(0.4, (120, 160, 3)).astype(np.uint8)
    dark[5, 5] = 255  # a hot pixel
    lamps = np.clip(400 * np.exp(-np.hypot(*np.mgrid[-60:60, -80:80]) / 15), 0, 255).astype(np.uint8)
    shaded = soft_disc() // 255 * np.linspace(60, 255, 160).astype(np.uint8)[:, None]
    for picture in (dark, np.zeros_like(dark), np.dstack([lamps] * 3), shaded, 255 - shaded, soft_disc((200, 30, 30))[
        :, :, :
    ] // 2 + rng.integers(0, 99, (120, 160, 3)).astype(np.uint8)):  # fmt: skip
        assert not is_mask(np.asarray(picture, np.uint8))
