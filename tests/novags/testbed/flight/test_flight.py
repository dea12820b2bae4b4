"""Claims about films: the path goes smoothly through the cameras, frames show what they say, files are readable."""

import errno
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags import cli  # noqa: E402
from novags.cameras.estimate import centers_of  # noqa: E402
from novags.splats import Gaussians, Views, rasterize, write_ply  # noqa: E402
from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.flight import video  # noqa: E402
from novags.testbed.flight.film import film  # noqa: E402
from novags.testbed.flight.panels import BAR, CaptionedPicture, frame  # noqa: E402
from novags.testbed.flight.path import distances, fly, paced, shorter_order  # noqa: E402
from novags.testbed.folders.references import references  # noqa: E402
from novags.testbed.folders.run import open_run  # noqa: E402
from novags.testbed.stages.camera_source import viewer_cameras  # noqa: E402
from simscenes.rigs import orbit_rig  # noqa: E402
from tests.fuzz.readers.records import make_run  # noqa: E402

QUIET = Console(quiet=True)


def ring(count: int) -> np.ndarray:
    """Cameras evenly on a quarter of a circle of radius 2 around the origin, which they look at."""
    viewmats = np.tile(np.eye(4), (count, 1, 1))
    for viewmat, angle in zip(viewmats, np.linspace(0, np.pi / 2, count), strict=True):
        forward = -np.array([np.cos(angle), np.sin(angle), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        viewmat[:3, :3] = np.stack([np.cross(down, forward), down, forward])
        viewmat[:3, 3] = [0.0, 0.0, 2.0]
    return viewmats


def test_a_path_passes_through_every_camera_and_stays_on_their_circle() -> None:
    given = ring(7)
    flight = fly(given, 61)
    assert len(flight.viewmats) == 61
    assert (flight.distance < 1e-9).sum() == 7
    assert set(flight.nearest[flight.distance < 1e-9]) == set(range(7))
    turns, moves = flight.viewmats[:, :3, :3], flight.viewmats[:, :3, 3]
    assert np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    centers = -np.einsum("fji,fj->fi", turns, moves)
    assert np.linalg.norm(centers, axis=1) == pytest.approx(np.full(61, 2.0), abs=5e-3)
    steps = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    assert steps.max() < 1.1 * steps.min()  # an even pace
    second = np.linalg.norm(np.diff(centers, 2, axis=0), axis=1)
    assert second.max() < 0.06 * steps.min()  # without corners: straight lines would turn by 15 degrees at a camera


@pytest.mark.parametrize("frames", [2, 5, 8, 42, 43, 44, 50, 300])
def test_a_flight_has_the_frames_that_were_asked_for_however_many_cameras_there_are(frames: int) -> None:
    """Rationale: 43 cameras made 43 frames where 8 were asked for, and dense ones more than asked for even so."""
    dense = ring(200)[np.r_[0:40, 60, 150, 199]]
    flight = fly(dense, frames)
    assert len(flight.viewmats) == frames
    passed = set(flight.nearest[flight.distance < 1e-9])
    assert passed == set(range(len(dense))) if frames == 300 else passed >= {0, len(dense) - 1}
    pace = np.diff(np.arctan2(*centers_of(flight.viewmats)[:, 1::-1].T)) * (frames - 1) / (np.pi / 2)
    assert pace == pytest.approx(1, abs=0.02 if frames < len(dense) else 1.02)


def test_few_frames_are_at_an_even_pace_past_many_cameras() -> None:
    assert paced(np.r_[0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 2.0], 5) == pytest.approx([0, 0.5, 1, 1.5, 2])
    assert paced(np.r_[0.0, 0.1, 0.6, 1.9, 2.0], 5) == pytest.approx([0, 0.6, 0.6 + 1.4 / 3, 0.6 + 2.8 / 3, 2])


def test_photographs_in_no_order_are_visited_along_the_shorter_way() -> None:
    given = ring(9)
    shuffled = given[[0, 5, 2, 8, 1, 7, 3, 6, 4]]
    assert shorter_order(distances(shuffled, shuffled)) == [0, 4, 2, 6, 8, 1, 7, 5, 3]
    assert shorter_order(distances(given, given)) == list(range(9))


def test_ways_between_cameras_count_in_extents() -> None:
    cameras = np.tile(np.eye(4), (2, 1, 1))
    cameras[1, 0, 3] = -3.0
    assert distances(cameras, cameras)[0, 1] == pytest.approx(3 / (1.1 * 1.5))


def test_cameras_that_stand_twice_at_a_place_do_not_stop_the_flight() -> None:
    given = ring(4)
    flight = fly(given[[0, 1, 1, 2, 3]], 20)
    assert np.isfinite(flight.viewmats).all()
    with pytest.raises(ValueError, match="at least 2 different cameras, got 3 at one place"):
        fly(given[[1, 1, 1]], 20)


def test_a_frame_holds_whole_pixels_and_is_even() -> None:
    image = np.random.default_rng(0).random((33, 25, 3)).astype(np.float32)
    made = frame([CaptionedPicture(image, "a", "b"), CaptionedPicture(image[:, :11], "c", "long " * 40)])
    assert made.shape == (330 + BAR, 250 + 8 + 110, 3)
    codes = np.round(255 * image).astype(np.uint8)
    assert (made[5:330:10, 5:250:10] == codes).all()
    assert (made[5:330:10, 263:368:10] == codes[:, :11]).all()


def test_the_highest_picture_of_a_film_need_not_be_the_first() -> None:
    low, high = (CaptionedPicture(np.zeros((rows, 40, 3), np.float32), "a", "") for rows in (900, 9000))
    assert frame([low, high]).shape == frame([high, low]).shape
    assert max(frame([low, high]).shape) <= 8190


@pytest.mark.parametrize("shape", [(300, 4000, 3), (9000, 40, 3)])
def test_pictures_too_large_for_a_film_are_shrunk_alike(tmp_path: Path, shape: tuple[int, ...]) -> None:
    """Rationale: three photographs of a telephone side by side were refused, as if OpenCV could not write .mp4."""
    rendered, truth = np.zeros(shape, np.float32), np.ones(shape, np.float32)
    made = frame(
        [CaptionedPicture(rendered, "a", ""), CaptionedPicture(truth, "b", ""), CaptionedPicture(truth, "c", "")]
    )
    assert max(made.shape) <= 8190
    assert made.shape[0] % 2 == made.shape[1] % 2 == 0
    rows, columns = np.nonzero((made[:-BAR] == 0).all(-1))
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert width / height == pytest.approx(shape[1] / shape[0], rel=0.02)
    assert (made[:-BAR] == 255).all(-1).sum() == 2 * height * width
    with film(tmp_path / "wide.mp4", 24.0, 1) as made_of:
        made_of.add(made)
    assert (tmp_path / "wide.mp4").stat().st_size > 0


@pytest.mark.parametrize("suffix", [".mp4", ".webp"])
def test_a_film_has_its_frames_in_order(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"f{suffix}"
    with film(path, 10, 3) as made:
        for level in (40, 120, 200):
            made.add(np.full((64, 96, 3), level, np.uint8))
    if suffix == ".mp4":
        reader, levels = cv2.VideoCapture(str(path)), []
        while (read := reader.read())[0]:
            levels.append(read[1].mean())
        assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    else:
        from PIL import Image, ImageSequence

        levels = [np.asarray(picture.convert("RGB")).mean() for picture in ImageSequence.Iterator(Image.open(path))]
    assert levels == pytest.approx([40, 120, 200], abs=4)


def test_frames_that_do_not_fit_into_memory_together_are_refused_with_the_first(tmp_path: Path) -> None:
    frame = np.zeros((64, 96, 3), np.uint8)
    with pytest.raises(ValueError, match=r"200000 frames of 96 x 64 are too many for a WebP.*3\.7 GB.*ends in \.mp4"):
        with film(tmp_path / "f.webp", 10, 200_000) as made:
            made.add(frame)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fps", [24.0, 30.0, 220.0])
def test_a_webp_lasts_as_long_as_its_frames(tmp_path: Path, fps: float) -> None:
    path = tmp_path / "f.webp"
    with film(path, fps, 33) as made:
        for level in range(33):
            made.add(np.full((8, 8, 3), 7 * level, np.uint8))
    with Image.open(path) as read:
        durations = []
        for k in range(read.n_frames):
            read.seek(k)
            read.load()
            durations.append(read.info["duration"])
    assert sum(durations) == pytest.approx(1000 * 33 / fps, abs=1)


def test_an_interrupted_webp_is_not_encoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[Any] = []
    monkeypatch.setattr(Image.Image, "save", lambda *given, **more: saved.append(given))
    with pytest.raises(KeyError), film(tmp_path / "f.webp", 10, 2) as made:  # noqa: PT012  # frames, then the error
        made.add(np.zeros((8, 8, 3), np.uint8))
        raise KeyError
    assert not saved
    assert not list(tmp_path.iterdir())


def test_a_film_that_fails_leaves_no_file(tmp_path: Path) -> None:
    def shoot() -> None:
        with film(tmp_path / "f.mp4", 10, 2) as made:
            made.add(np.zeros((64, 96, 3), np.uint8))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        shoot()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("room", [300, 20_000])
@pytest.mark.parametrize("suffix", [".mp4", ".webp"])
def test_a_film_that_the_disk_has_no_room_for_is_an_error_and_no_file(tmp_path: Path, suffix: str, room: int) -> None:
    """Rationale: OpenCV says nothing of a full disk, and half a film, which nothing plays, was called 24 frames."""
    pictures = np.random.default_rng(0).integers(0, 255, (24, 64, 96, 3)).astype(np.uint8)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def shoot() -> None:
        with film(tmp_path / f"f{suffix}", 10, 24) as made:
            for picture in pictures:
                made.add(picture)

    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        with pytest.raises(OSError, match=r"is the disk full|File too large"):
            shoot()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_a_film_where_nothing_can_be_written_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rationale: OpenCV says no more than that it cannot, and was said to be unable to write MP4 at all."""

    def refused(path: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "touch", refused)
    denied = r"Permission denied: '.*/f\.mp4'"
    with pytest.raises(PermissionError, match=denied), film(tmp_path / "f.mp4", 10, 1) as made:
        made.add(np.zeros((64, 96, 3), np.uint8))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with Gaussians and three cameras on an orbit."""
    folder = tmp_path_factory.mktemp("film")
    make_run(folder)
    record = json.loads((folder / "naive" / "run.json").read_text())
    record["enhancement"]["config"] = {}
    (folder / "naive" / "run.json").write_text(json.dumps(record))
    rig = orbit_rig(3, 32, 24, 50.0, radius=3.0)
    viewmats, Ks = (torch.tensor(np.asarray(m), dtype=torch.float32) for m in (rig.viewmats, rig.Ks))
    views = [Views(viewmats[k : k + 1], Ks[k : k + 1], 32, 24) for k in range(3)]
    (folder / "naive" / "cameras.json").write_text(json.dumps(viewer_cameras(["0000", "0001", "0002"], views)))
    generator = torch.Generator().manual_seed(0)
    points, colors = (torch.rand(200, 3, generator=generator) for _ in range(2))
    write_ply(folder / "naive" / "point_cloud.ply", Gaussians.from_points(points - 0.5, colors, sh_degree=0))
    return folder / "naive"


def test_frames_show_the_gaussians_from_there_and_the_nearest_pictures(
    run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    frames, notes = list[np.ndarray](), list[list[str]]()

    @contextmanager
    def kept(path: Path, fps: float, count: int) -> Iterator[Any]:
        assert (fps, count) == (9.0, 9)
        yield type("Kept", (), {"add": lambda self, made: frames.append(made)})()

    def noted(panels: list[CaptionedPicture]) -> np.ndarray:
        notes.append([panel.note for panel in panels])
        return frame(panels)

    monkeypatch.setattr(video, "film", kept)
    monkeypatch.setattr(video, "frame", noted)
    count = video.make_video(open_run(run), tmp_path / "f.mp4", QUIET, seconds=1.0, fps=9.0)
    assert count == len(frames) == 9
    opened = open_run(run)
    capture, lit = opened.inputs(QUIET)
    gaussians = video.scene_of(opened).gaussians
    lenses = json.loads((run / "cameras.json").read_text())
    turn, place = (np.array(lenses[0][key]) for key in ("rotation", "position"))
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = turn.T, -turn.T @ place
    K = np.median(capture.cameras.rig.Ks, axis=0)
    K[0, 0], K[1, 1] = lenses[0]["fx"], lenses[0]["fy"]
    g = gaussians
    there = torch.tensor(viewmat, dtype=torch.float32)[None], torch.tensor(K, dtype=torch.float32)[None]
    image, _, _ = rasterize(g.means, g.quats, g.scales, g.opacities, g.sh, *there, 32, 24, sh_degree=0)
    times = 14  # 24 rows become 336
    shown = frames[0][times // 2 : 336 : times, times // 2 : 32 * times : times]
    assert np.abs(shown.astype(float) - 255 * image[0].numpy().clip(0, 1)).max() <= 0.51
    truth = references(opened, capture, lit, 0)["enhanced"]
    left = 32 * times + 8
    assert np.abs(frames[0][7:336:times, left + 7 : left + 32 * times : times] - 255 * truth).max() <= 0.51
    assert notes[0] == ["reconstruction", "view 0000", "view 0000"]
    assert notes[1][1:] == ["no picture from here; nearest: view 0000"] * 2
    assert notes[-1][1] == "view 0002"


def test_the_film_of_a_run_with_a_dot_in_its_name_has_that_name(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: variants like sh0.5 and sh0.7 both became sh0.mp4."""
    shutil.copytree(run.parent, tmp_path / "x")
    (tmp_path / "x" / run.name).rename(tmp_path / "x" / "sh0.5")
    monkeypatch.setattr(video, "make_video", lambda opened, path, *_, **__: path.write_bytes(b"film") and 1)
    monkeypatch.setattr(sys, "argv", ["novags", "video", str(tmp_path / "x" / "sh0.5")])
    cli.main()
    assert (tmp_path / "x" / "sh0.5.mp4").read_bytes() == b"film"


def test_a_film_is_made_by_one_process_which_removes_what_a_killed_one_left(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    left = tmp_path / f".f.{2**30}.partial.mp4"  # of a process that is no more: there are no such numbers
    left.write_bytes(b"half")
    monkeypatch.setattr(video, "make_video", lambda opened, path, *_, **__: path.write_bytes(b"film") and 1)
    monkeypatch.setattr(sys, "argv", ["novags", "video", str(run), "--out", str(tmp_path / "f.mp4")])
    holder = (
        f"import sys; from sensor_model.files.lock import locked\nwith locked({str(tmp_path)!r}, name='.f.mp4.lock'):"
    )
    with subprocess.Popen([sys.executable, "-c", f"{holder}\n print(flush=True); sys.stdin.read()"],
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:  # fmt: skip
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(SystemExit):
            cli.main()
        other.communicate()
    assert "is in use by" in capsys.readouterr().err
    cli.main()
    assert [path.name for path in tmp_path.iterdir()] == ["f.mp4"]


def test_a_run_without_gaussians_and_files_that_are_there_are_refused_in_one_line(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(*words: str) -> str:
        monkeypatch.setattr(sys, "argv", ["novags", "video", str(run), *words])
        with pytest.raises(SystemExit):
            cli.main()
        return capsys.readouterr().err

    (tmp_path / "f.mp4").write_bytes(b"mine")
    assert "is there already: choose another --out, or add --overwrite" in said("--out", str(tmp_path / "f.mp4"))
    assert "must be called .mp4 or .webp, got f.gif" in said("--out", str(tmp_path / "f.gif"))
    assert "must not lie inside its input" in said("--out", str(run / "f.mp4"))
    assert "got -1 s at 24 frames a second" in said("--out", str(tmp_path / "g.mp4"), "--seconds", "-1")
    monkeypatch.setattr(video, "scene_of", lambda opened: None)
    assert "only Gaussians and fields can be rendered from new places, and naive has made neither" in said(
        "--out", str(tmp_path / "g.mp4"))  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["f.mp4"]
    (tmp_path / "d.mp4").mkdir()
    assert "d.mp4 is a folder: choose another --out" in said("--out", str(tmp_path / "d.mp4"), "--overwrite")


def test_a_film_has_the_median_focal_lengths_of_its_cameras(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run.parent, tmp_path / "copy")
    file = tmp_path / "copy" / run.name / "cameras.json"
    lenses = json.loads(file.read_text())
    for lens, fx in zip(lenses, (10.0, 20.0, 40.0), strict=True):
        lens["fx"], lens["fy"] = fx, 2 * fx
    file.write_text(json.dumps(lenses))
    opened = open_run(file.parent)
    K = video.Course.of(opened, opened.inputs(QUIET)[0]).K
    assert (K[0, 0], K[1, 1]) == (20.0, 40.0)
