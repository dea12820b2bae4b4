"""Claims about photographs of which nothing is known: cameras, lens and pictures come out as they were."""

import io
import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import cv2
import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from novags.cameras.align import align
from novags.cameras.motion import registration
from novags.cameras.motion.registration import MANY, Observed, Registered, Shot, pairs_of
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.photographs.video import write_frames
from novags.testbed.folders.set import open_source
from novags.testbed.ledger.contents import folder_digest
from novags.testbed.stages import posing
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.stages.posing import levelled
from novags.testbed.stages.seen import denoised
from sensor_model.isp import srgb_to_linear, to_srgb8
from simscenes import load_set, orbit_rig
from simscenes.sets.multiview import is_rendered
from simscenes.sets.readers.bare import picture_files, survey
from simscenes.sets.readers.photographs import DistortedPinhole

QUIET = Console(quiet=True)
WIDTH, HEIGHT, FOCAL, K1 = 200, 150, 190.0, -0.12
TURNED, MARKED, NOISE = 5, 2, "noise.png"


def through_a_lens(see, viewmat: np.ndarray) -> np.ndarray:
    """The picture that a lens with barrel distortion makes."""
    wide = np.array([[FOCAL, 0, WIDTH], [0, FOCAL, HEIGHT], [0, 0, 1.0]])  # of a pinhole twice as wide and high
    picture, _ = see(viewmat, wide, 2 * WIDTH, 2 * HEIGHT)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    seen = np.stack([x, y], -1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(seen, K, np.array([K1, 0, 0, 0, 0]), P=wide).reshape(HEIGHT, WIDTH, 2) - 0.5
    return cv2.remap(picture, *np.moveaxis(ideal.astype(np.float32), -1, 0), cv2.INTER_CUBIC)


@pytest.fixture(scope="module")
def taken(corner, tmp_path_factory) -> tuple[object, Path]:
    """Photographs of the corner: one marked as lying, one stored turned, and one of something else."""
    scene, folder = corner(9, WIDTH, HEIGHT), tmp_path_factory.mktemp("taken")
    for i, viewmat in enumerate(scene.rig.viewmats):
        picture = Image.fromarray(through_a_lens(scene.see, viewmat))
        exif = Image.Exif()
        if i == MARKED:
            exif[0x0112] = 6  # "turn me to look at me"; the pixels are as the sensor saw them
        if i == TURNED:
            picture = Image.fromarray(np.ascontiguousarray(np.rot90(np.asarray(picture), -1)))
        picture.save(folder / f"IMG {i}.jpg", quality=97, exif=exif)
    noise = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    Image.fromarray(noise).save(folder / NOISE)
    (folder / "notes.txt").write_text("not a picture")
    return scene, folder


@pytest.fixture(scope="module")
def placed(taken, tmp_path_factory) -> tuple[Path, str]:
    out, said = tmp_path_factory.mktemp("placed") / "set", io.StringIO()
    stages.poses(out, PosesConfig(photographs=taken[1]), Console(stream=said))
    return out, said.getvalue()


def test_cameras_and_lens_are_found_however_the_pictures_are_stored(taken, placed) -> None:
    scene, (out, _) = taken[0], placed
    record, views = json.loads((out / "set.json").read_text()), load_set(out)
    assert record["registered"] == 9
    assert record["turned"] == [f"IMG {TURNED}.jpg"]
    assert not is_rendered(out)
    where = [int(name.split()[1]) for name in views.names]
    assert where == list(range(9))
    found = align(torch.tensor(views.rig.viewmats), torch.tensor(scene.rig.viewmats))
    off = np.asarray(found.rotation_deg)
    # The turned picture was turned back, or further: its camera is the same up to a roll by half a turn.
    rolled = min(off[TURNED], abs(180 - off[TURNED]))
    assert max(np.delete(off, TURNED).max(), rolled) < 0.5
    assert np.asarray(found.centre_error).max() < 0.03
    lens = max(record["lenses"], key=lambda lens: abs(lens["distortion"][0]))
    assert lens["K"][0][0] == pytest.approx(FOCAL, rel=0.03)
    assert lens["distortion"][0] == pytest.approx(K1, abs=0.03)


def test_up_in_the_photographs_is_up_in_the_world(placed) -> None:
    """COLMAP's world is turned like its first picture; viewers, flights and nerfstudio take z for up."""
    views = load_set(placed[0])
    up = -views.rig.viewmats[:, 1, :3].mean(0)
    assert up / np.linalg.norm(up) == pytest.approx([0, 0, 1], abs=1e-6)


@pytest.mark.parametrize("up", [(0.0, 0.0, -1.0), (0.6, 0.0, 0.8), (0.0, -1.0, 0.0)])
def test_a_world_is_turned_upright_with_all_that_is_in_it(up: tuple[float, float, float]) -> None:
    turn, _ = Rotation.align_vectors([up], [[0.0, 0.0, 1.0]])
    rig = orbit_rig(5, 20, 16, 50, radius=3.0, elevation_deg=30)
    world = np.eye(4)
    world[:3, :3] = turn.as_matrix()
    points = np.random.default_rng(0).normal(size=(20, 3))
    lying = Registered((0, 1, 2, 3, 4), rig.viewmats @ world.T, (), points @ world[:3, :3].T, (), 0.0)
    found = levelled(lying)
    local = [p.viewmats[:, :3, :3] @ p.points.T + p.viewmats[:, :3, 3:] for p in (lying, found)]
    assert np.allclose(*local)  # all cameras see what they saw
    above = -found.viewmats[:, 1, :3].mean(0)
    assert above / np.linalg.norm(above) == pytest.approx([0, 0, 1])
    opposed = replace(lying, viewmats=np.stack([np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])]))
    assert levelled(opposed) is opposed


def test_the_pictures_of_the_set_are_those_of_its_pinholes(taken, placed) -> None:
    scene, views = taken[0], load_set(placed[0])
    for i in (0, MARKED, 8):
        truth, _ = scene.see(scene.rig.viewmats[i], views.rig.Ks[i], WIDTH, HEIGHT)
        error = views.image(i).astype(float) - truth
        # Distorted as they were taken, they differ by 19 codes; with a principal point 1 px off, by 16.
        assert np.sqrt(np.mean(error[4:-4, 4:-4] ** 2)) < 9


def test_points_lie_on_the_surfaces_and_have_the_colours_of_the_pictures(taken, placed) -> None:
    scene, views = taken[0], load_set(placed[0])
    sparse = views.points()
    points, colors = sparse.xyz, sparse.rgb
    keep = [i for i in range(9) if i != TURNED]
    found = align(torch.tensor(views.rig.viewmats)[keep], torch.tensor(scene.rig.viewmats)[keep])
    off = scene.distance(found.similarity.apply(torch.tensor(points, dtype=torch.float32)).numpy())
    assert len(points) > 200
    assert np.median(off) < 0.02
    # Tracks are the measured ones: their errors are those of features, neither zero nor wild.
    assert sparse.lengths.min() >= 2
    assert 0.02 < np.mean(sparse.error) < 1.0
    pixels, _ = views.rig.project(points)
    inside = ((pixels[0] >= 0) & (pixels[0] < (WIDTH, HEIGHT))).all(-1)
    x, y = pixels[0][inside].astype(int).T
    shown = views.image(0)[y, x].astype(float)
    assert np.corrcoef(shown[:, 0], colors[inside, 0])[0, 1] > 0.7


def test_what_did_not_register_is_counted_and_named_everywhere(placed, tmp_path: Path) -> None:
    out, said = placed
    line = f"1 of 10 photographs have no camera and are left out: {NOISE}"
    assert "9 of 10 photographs have a place" in said
    assert line in said
    assert json.loads((out / "set.json").read_text())["unregistered"] == [NOISE]
    assert load_set(out).unregistered == (NOISE,)
    later = io.StringIO()
    open_source(out, Console(stream=later))
    assert line in later.getvalue()


def test_the_same_photographs_give_the_same_set_and_are_placed_once(taken, placed, tmp_path: Path) -> None:
    config = PosesConfig(photographs=taken[1])
    stages.poses(tmp_path / "again", config, QUIET)
    assert folder_digest(tmp_path / "again") == folder_digest(placed[0])
    before = (placed[0] / "set.json").stat().st_mtime_ns
    stages.poses(placed[0], config, QUIET)
    assert (placed[0] / "set.json").stat().st_mtime_ns == before
    with pytest.raises(ValueError, match=r"another request \(max_features was 4096, is 500\)"):
        stages.poses(placed[0], PosesConfig(photographs=taken[1], max_features=500), QUIET)


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_the_seed_reaches_matches_and_cameras(
    mapper: Any, taken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """COLMAP is asked for the seed that it was given, and stopped then: clean pictures are placed alike with most."""
    match, given = pycolmap.match_image_pairs, list[int]()

    def matched(database, matching, pairing, verification, **rest):
        given.append(verification.ransac.random_seed)
        return match(database, matching, pairing, verification, **rest)

    def stopped(database, pictures, out, options, **rest):
        given.append(options.random_seed)
        raise ValueError("far enough")

    monkeypatch.setattr(pycolmap, "match_image_pairs", matched)
    monkeypatch.setattr(pycolmap, f"{mapper}_mapping", stopped)
    config = PosesConfig(photographs=taken[1], max_features=100, mapper=mapper, seed=7)
    with pytest.raises(ValueError, match="far enough"):
        stages.poses(tmp_path / "set", config, QUIET)
    assert set(given) == {7}


def test_every_picture_is_matched_with_all_later_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = list[str]()
    monkeypatch.setattr(
        pycolmap, "match_image_pairs",
        lambda database, matching, pairing, *_, **rest: listed.append(Path(pairing.match_list_path).read_text()),
    )  # fmt: skip
    shots = [Shot(f"{name}.png", 0, None) for name in "abc"]
    registration._match(pycolmap, tmp_path / "database.db", tmp_path, shots, False, 0, lambda *_: None)
    assert listed == ["a.png b.png\na.png c.png\n", "b.png c.png\n"]


def test_pictures_that_do_not_belong_together_are_refused_with_advice(tmp_path: Path) -> None:
    (tmp_path / "noise").mkdir()
    for i in range(3):
        noise = np.random.default_rng(i).integers(0, 255, (64, 64, 3), np.uint8)
        Image.fromarray(noise).save(tmp_path / "noise" / f"{i}.png")
    with pytest.raises(ValueError, match="fewer than 3 of the 3 photographs .* more overlap"):
        stages.poses(tmp_path / "set", PosesConfig(photographs=tmp_path / "noise"), QUIET)
    assert not (tmp_path / "set" / "set.json").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="holds 0 photographs .* at least 3 are needed"):
        stages.poses(tmp_path / "set", PosesConfig(photographs=tmp_path / "empty"), QUIET)


def test_a_lens_that_cannot_be_undone_is_refused_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: chance matches of eight pictures of two places were fitted by this one; a rig was said to be wrong."""
    (photos := tmp_path / "photos").mkdir()
    for k in range(3):
        cv2.imwrite(str(photos / f"{k}.png"), np.full((48, 48, 3), 80 * k, np.uint8))
    K = np.array([[38.93, 0, 24], [0, 221.46, 24], [0, 0, 1]])
    lens = DistortedPinhole(K, (-0.68075, 0.118315, -0.059702, 0.014953, 0.0))
    seen = Observed(np.zeros(1, np.intp), np.full((1, 2), 24.0), np.zeros((1, 2)))
    rig = orbit_rig(3, 48, 48, 50.0, radius=3.0)
    found = Registered((0, 1, 2), rig.viewmats, (lens,) * 3, np.zeros((1, 3)), (seen,) * 3, 0.5)
    monkeypatch.setattr(posing, "register", lambda *_, **__: found)
    with pytest.raises(ValueError, match=r"a lens whose distortion cannot be undone: take them with more overlap"):
        stages.poses(tmp_path / "set", PosesConfig(photographs=photos), Console(quiet=True))


def test_sizes_are_brought_together_and_a_focal_length_in_the_header_is_used(tmp_path: Path) -> None:
    def picture(name: str, width: int, height: int, **exif: object) -> None:
        marks = Image.Exif()
        if exif:
            marks.get_ifd(0x8769)[0xA405] = exif["focal_35"]
        Image.new("RGB", (width, height)).save(tmp_path / name, exif=marks)

    for i in range(3):
        picture(f"{i}.jpg", 400, 300, focal_35=28)
    picture("larger.jpg", 800, 600)
    picture("upright.jpg", 300, 400)
    picture("square.jpg", 500, 500)
    bare, size = survey(picture_files(tmp_path), 200)
    assert size == (200, 150)
    found = {one.file.stem: one for one in bare}
    assert [found[n].size for n in ("0", "larger", "upright", "square")] == [(200, 150), (200, 150), (200, 150),
                                                                           (200, 200)]  # fmt: skip
    assert [one.turned for one in bare] == [one.file.stem == "upright" for one in bare]
    assert len({found[n].camera for n in "012"}) == 1
    assert len({one.camera for one in bare}) == 4
    # Equal diagonal angle of view: 28 mm on film of 43.27 mm diagonal, here of 250 px.
    assert found["0"].focal == pytest.approx(28 / 43.267 * 250)
    assert found["larger"].focal is None


def test_frames_are_taken_from_a_video_at_even_times(tmp_path: Path) -> None:
    video = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for i in range(20):
        writer.write(np.full((48, 64, 3), 10 * i, np.uint8))
    writer.release()
    (tmp_path / "frames").mkdir()
    frames = write_frames(video, 4.0, tmp_path / "frames", lambda *_: None)
    assert list(frames.values()) == [f"walk.avi at {t:.2f} s" for t in (0, 0.3, 0.5, 0.8, 1.0, 1.3, 1.5, 1.8)]
    levels = [cv2.imread(str(file)).mean() for file in frames]
    assert levels == pytest.approx([0, 30, 50, 80, 100, 130, 150, 180], abs=3)
    video.write_bytes(b"RIFF" + bytes(100))
    with pytest.raises(ValueError, match="is not a video that OpenCV reads: convert it"):
        write_frames(video, 4.0, tmp_path / "frames", lambda *_: None)


def test_neighbours_far_frames_and_loops_of_a_long_video_are_matched_but_not_all_pairs() -> None:
    assert sum(map(len, pairs_of(30, True))) == 30 * 29 // 2
    pairs = pairs_of(1000, True)
    assert pairs[0][:10] == list(range(1, 11))
    assert {16, 512, 990} <= set(pairs[0])
    assert sum(map(len, pairs)) < 0.05 * 1000 * 999 / 2
    assert sum(map(len, pairs_of(200, False))) == 200 * 199 // 2


def test_a_folder_without_photographs_names_the_kinds_of_file_that_it_holds(tmp_path: Path) -> None:
    for name in ("0.gif", "1.GIF", "below/2.gif", "notes.txt", ".hidden.xcf"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(ValueError, match=r"holds 0 photographs .*; it also holds 3 .gif, 1 .txt: convert pictures"):
        stages.poses(tmp_path / "out", PosesConfig(photographs=tmp_path), QUIET)
    (tmp_path / "3.nef").write_bytes(b"")
    with pytest.raises(ValueError, match="1 .nef: develop camera raw files, convert pictures to PNG or JPEG"):
        stages.poses(tmp_path / "out", PosesConfig(photographs=tmp_path), QUIET)


def test_frames_a_second_are_of_a_video_and_refused_for_a_folder(tmp_path: Path) -> None:
    """Rationale: they were ignored there without a word."""
    with pytest.raises(ValueError, match=r"fps belongs to a video, and .* is a folder, .*leave out fps, got 3"):
        PosesConfig(photographs=tmp_path, fps=3.0)
    assert PosesConfig(photographs=tmp_path).resolved()["fps"] is None
    (tmp_path / "walk.mp4").touch()
    assert PosesConfig(photographs=tmp_path / "walk.mp4").resolved()["fps"] == 2.0  # as it always was


def test_the_scene_is_called_as_its_folder_is_dots_and_all(tmp_path: Path) -> None:
    """Rationale: of "garden.1" and "garden.2" both were "garden"."""
    for name in ("garden.1", "garden.2/images"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "walk.mp4").touch()
    places = (tmp_path / "garden.1", tmp_path / "garden.2" / "images", tmp_path / "walk.mp4")
    assert [PosesConfig(photographs=place).name for place in places] == ["garden.1", "garden.2", "walk"]


@pytest.mark.parametrize(("count", "model"), [(MANY, "OPENCV"), (MANY - 1, "SIMPLE_RADIAL")])
@pytest.mark.parametrize("place", [0, MANY])
def test_a_lens_of_many_pictures_has_all_its_parameters_and_starts_as_stated(
    count: int, model: str, place: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The picture of another lens comes first or last."""
    shots = [Shot(f"{i}.png", 0, 50.0) for i in range(count)]
    shots.insert(place, Shot("other.png", 1, None))
    for shot in shots:
        Image.new("L", (40, 30)).save(tmp_path / shot.name)
    lenses = []
    fake = SimpleNamespace(
        FeatureExtractor=SimpleNamespace(create=lambda *_: None), Device=SimpleNamespace(cpu=0), Database=MagicMock(),
        ImageReaderOptions=lambda **given: SimpleNamespace(**given), CameraMode=SimpleNamespace(SINGLE=0),
        import_images=lambda database, folder, mode, names, reader: lenses.append((names[0], reader)),
    )  # fmt: skip
    monkeypatch.setattr(registration, "detect", lambda *given: 7 if given[2] == "other.png" else 8)
    registration._detect(fake, tmp_path / "d", tmp_path, shots, None, lambda *_: None)
    new = {name: reader for name, reader in lenses if hasattr(reader, "camera_model")}
    assert {name: reader.camera_model for name, reader in new.items()} == {"other.png": "SIMPLE_RADIAL", "0.png": model}
    assert not hasattr(new["other.png"], "camera_params")
    focal = [50, 50] if model == "OPENCV" else [50]
    stated = [float(value) for value in new["0.png"].camera_params.split(",")]
    assert stated == [*focal, 20, 15, *[0] * (4 if len(focal) == 2 else 1)]
    assert {reader.existing_camera_id for name, reader in lenses if name not in new} == {8}


def test_the_global_mapper_finds_the_same_cameras_and_lens(taken, tmp_path: Path) -> None:
    record = stages.poses(tmp_path / "set", PosesConfig(photographs=taken[1], mapper="global"), QUIET)
    views = load_set(tmp_path / "set")
    assert record["mapper"] == "global"
    kept = [i for i in range(9) if i != TURNED]
    where = [int(name.split()[1]) for name in views.names]
    assert set(kept) <= set(where)
    found = align(torch.tensor(views.rig.viewmats), torch.tensor(taken[0].rig.viewmats[where]))
    assert np.asarray(found.rotation_deg)[[where.index(i) for i in kept]].max() < 0.5
    lens = max(record["lenses"], key=lambda lens: abs(lens["distortion"][0]))
    assert lens["K"][0][0] == pytest.approx(FOCAL, rel=0.03)
    assert lens["distortion"][0] == pytest.approx(K1, abs=0.03)


def test_dark_photographs_have_their_place_where_their_own_features_are_noise(
    corner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten electrons of white in shot noise, shown as a camera shows them: black."""
    monkeypatch.setattr(denoised, "STEPS", 60)
    scene, draw = corner(10, WIDTH, HEIGHT), np.random.default_rng(0)
    (tmp_path / "dark").mkdir()
    for i, viewmat in enumerate(scene.rig.viewmats):
        K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
        light = srgb_to_linear(scene.see(viewmat, K, WIDTH, HEIGHT)[0] / 255)
        code = to_srgb8(draw.poisson(10 * light) / 1000)
        Image.fromarray(code).save(tmp_path / "dark" / f"{i}.png")
    found = {}
    for pictures in ("auto", "raw"):
        with suppress(ValueError) if pictures == "auto" else pytest.raises(ValueError, match="--pictures denoised"):
            stages.poses(tmp_path / pictures, PosesConfig(photographs=tmp_path / "dark", pictures=pictures), QUIET)
            views = load_set(tmp_path / pictures)
            where = [int(name) for name in views.names]
            aligned = align(torch.tensor(views.rig.viewmats), torch.tensor(scene.rig.viewmats[where]))
            found[pictures] = len(where), np.asarray(aligned.rotation_deg).mean()
    assert found["auto"][0] == 10
    assert found["auto"][1] < 1
    assert "raw" not in found
