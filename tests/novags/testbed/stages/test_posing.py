"""On which files the cameras of photographs depend, and in which pictures they are looked for."""

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from novags.testbed.console.terminal import Console
from novags.testbed.importing.exposures import are_dark
from novags.testbed.stages import posing
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.study.plan import Planner
from simscenes import orbit_rig
from simscenes.sets.pictures.png import read_png, write_png
from simscenes.sets.readers.lens import DistortedPinhole

QUIET = Console(quiet=True)


def picture(file: Path, seed: int) -> None:
    write_png(file, np.random.default_rng(seed).integers(0, 255, (8, 8, 3)).astype(np.uint8))


def of_stage(photos: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    class Asked(Exception):
        pass

    def asked(*_: Any, inputs: Any, **__: Any) -> None:
        raise Asked(inputs())

    monkeypatch.setattr(posing, "run_stage", asked)
    with pytest.raises(Asked) as found:
        posing.poses(photos.parent / "set", PosesConfig(photographs=photos), QUIET)
    return found.value.args[0]


def of_plan(photos: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    return Planner(photos.parent / "store", QUIET)._posed(PosesConfig(photographs=photos))


@pytest.mark.parametrize("asked", [of_stage, of_plan])
def test_photographs_alone_and_all_of_them_decide_whether_cameras_are_found_again(
    asked: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos = tmp_path / "photos"
    for k in range(4):
        picture(photos / f"{k}.png", k)
    first = asked(photos, monkeypatch)
    (tmp_path / "beside.txt").write_text("no photograph")
    (photos / "notes.txt").write_text("no photograph")
    assert asked(photos, monkeypatch) == first
    found = [first]
    for k, seed in ((3, 9), (0, 8)):
        picture(photos / f"{k}.png", seed)
        found.append(asked(photos, monkeypatch))
    picture(photos / "4.png", 4)
    found.append(asked(photos, monkeypatch))
    assert len({str(each) for each in found}) == 4


@pytest.mark.parametrize("seed", [0, 7])
def test_the_seed_and_all_photographs_reach_the_search_for_cameras(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = dict[str, Any]()

    def register(folder: Path, shots: Any, **settings: Any) -> None:
        found.update(
            settings, shots=[shot.name for shot in shots], there=sorted(path.name for path in folder.iterdir())
        )

    monkeypatch.setattr(posing, "register", register)
    files = {f"{k}.png": tmp_path / f"{k}.png" for k in range(4)}
    for k, file in enumerate(files.values()):
        picture(file, k)
    with pytest.raises(ValueError, match="fewer than"):
        posing.place(files, tmp_path / "set", PosesConfig(photographs=tmp_path, seed=seed), QUIET)
    assert found["seed"] == seed
    assert found["shots"] == found["there"] == [f"{k:06d}.png" for k in range(4)]


def test_all_other_files_are_counted_where_photographs_are_missing(tmp_path: Path) -> None:
    for name in ("a/x.cr2", "b/y.CR2", "z.mov", "a/.hidden/u.mov", ".v.mov", "readme"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert posing._others(tmp_path) == (
        "; it also holds 2 .cr2, 1 .mov: develop camera raw files, convert pictures to PNG or JPEG"
    )


def test_the_only_other_file_is_named_where_photographs_are_missing(tmp_path: Path) -> None:
    (tmp_path / "z.mov").touch()
    assert posing._others(tmp_path) == "; it also holds 1 .mov: convert pictures to PNG or JPEG"


def test_photographs_and_masks_are_all_named_by_where_they_lie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["a/1.png", "a/2.png", "b/1.png", "b/c.png", "masks/1.png", "masks/c.png"]
    for k, name in enumerate(names):
        picture(tmp_path / name, k)
    monkeypatch.setattr(posing, "without_masks", lambda files: (
        [file for file in files if "masks" not in file.parts], [file for file in files if "masks" in file.parts]
    ))  # fmt: skip
    assert sorted(posing.masks_among(tmp_path)) == names[4:]
    assert posing.photographs_of(tmp_path) == {name: tmp_path / name for name in names[:4]}


def test_every_view_is_written_with_its_own_picture_and_doubted_by_its_own_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of five photographs three have a camera: the fifth, the first and the third."""
    rig = orbit_rig(3, 32, 24, 50.0, radius=3.0)
    lens = DistortedPinhole(K=rig.Ks[0], distortion=(0.0,) * 5)
    squeezed = DistortedPinhole(K=rig.Ks[0] * [[2.0], [1.0], [1.0]], distortion=(0.0,) * 5)
    codes = [np.full((24, 32, 3), 40 * k, np.uint8) for k in range(5)]
    files = [tmp_path / f"{name}.png" for name in "abcde"]
    for k, file in enumerate(files):
        picture(file, k % 4)  # the last one is a copy of the first
    bare: Any = [SimpleNamespace(pixels=lambda k=k: codes[k], size=(32, 24), turned=k in (1, 2), camera=k, focal=None,
                                 file=files[k]) for k in range(5)]  # fmt: skip
    points = np.random.default_rng(0).normal(0, 0.2, (6, 3))
    seen = [SimpleNamespace(points=np.arange(6), pixels=np.full((6, 2), 4.0), rays=np.zeros((6, 2))) for _ in range(3)]
    lenses = [lens, lens, squeezed]
    found: Any = SimpleNamespace(indices=[4, 0, 2], viewmats=rig.viewmats, lenses=lenses, points=points, seen=seen,
                                 error=0.5)  # fmt: skip
    names = posing.write_set(tmp_path / "set", files, bare, found, (32, 24), "s")
    assert names == ["e", "a", "c"]
    for name, i in zip(names, found.indices, strict=True):
        np.testing.assert_array_equal(np.round(255 * read_png(tmp_path / "set" / "images" / f"{name}.png")), codes[i])
    asked = dict[str, Any]()
    monkeypatch.setattr(
        posing, "camera_doubts", lambda own, viewmats, focals, **more: asked.update(more, own=own) or []
    )
    said = " ".join(posing._doubts([f.name for f in files], bare, found, (32, 20)))
    assert asked["own"] == ["e.png", "a.png", "c.png"]
    assert asked["seen"] == [6, 6, 6]
    assert "1 of 3 cameras have another focal length along x than along y" in said
    assert "2 of 5 photographs are turned" in said
    assert "5 of 5 photographs are of another shape" in said
    assert "1 of 5 photographs are copies of another one (e.png and a.png)" in said


def test_cameras_and_points_are_turned_upright_together() -> None:
    """Every point stays where each camera sees it, and up on average becomes z."""
    rig = orbit_rig(5, 32, 24, 50.0, radius=3.0)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", (0.4, -0.7, 1.1)).as_matrix()
    points = np.random.default_rng(0).normal(0, 0.2, (6, 3))
    found = posing.Registered(
        indices=list(range(5)), viewmats=rig.viewmats @ turn.T, points=points @ turn[:3, :3].T, lenses=[], seen=[],
        error=0.5,
    )  # fmt: skip
    upright = posing.levelled(found)
    up = -upright.viewmats[:, 1, :3].mean(0)
    np.testing.assert_allclose(up / np.linalg.norm(up), [0.0, 0.0, 1.0], atol=1e-9)
    assert np.abs(upright.viewmats - found.viewmats).max() > 0.1
    for before, after in zip(rig.viewmats, upright.viewmats, strict=True):
        np.testing.assert_allclose(
            upright.points @ after[:3, :3].T + after[:3, 3], points @ before[:3, :3].T + before[:3, 3], atol=1e-9
        )


@pytest.mark.parametrize(
    ("values", "dark"),
    [([50] * 3, True), ([52] * 3, False), ([20, 50, 200], True), ([20, 60, 200], False), ([0] * 3, True),
     ([10] * 20 + [200] * 4, True)],
)  # fmt: skip
def test_photographs_are_dark_by_nine_tenths_of_the_pixels_of_the_median_one(values: list[int], dark: bool) -> None:
    assert are_dark(lambda k: np.full((10, 20, 3), values[k], np.uint8), len(values)) is dark
    lamps = np.where(np.arange(200).reshape(10, 20, 1) < 18, 255, [8, 9, 10])
    assert are_dark(lambda k: lamps, 1) is True
    black_background = np.where(np.arange(200).reshape(10, 20, 1) < 30, 99, 0)
    assert are_dark(lambda k: black_background, 1) is False


@pytest.mark.parametrize(
    ("code", "asked", "found"),
    [(9, {}, ("denoised", "global")), (90, {}, ("raw", "incremental")),
     (9, {"pictures": "raw"}, ("raw", "incremental")), (90, {"pictures": "denoised"}, ("denoised", "global")),
     (9, {"mapper": "incremental"}, ("denoised", "incremental")), (90, {"mapper": "global"}, ("raw", "global")),
     (9, {"pictures": "enhanced"}, ("enhanced", "incremental"))],
)  # fmt: skip
def test_cameras_of_dark_photographs_are_looked_for_in_denoised_pictures_unless_others_are_named(
    code: int, asked: dict[str, Any], found: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """COLMAP is handed these pictures, in the order of the photographs, and the set has the photographs themselves."""
    given = dict[str, Any]()

    def register(folder: Path, shots: Any, **settings: Any) -> Any:
        shown = [np.round(255 * read_png(folder / shot.name)).astype(int)[0, 0, 0] for shot in shots]
        given.update(settings, shown=shown)
        rig = orbit_rig(3, 40, 30, 50.0, radius=3.0)
        lens = DistortedPinhole(K=rig.Ks[0], distortion=(0.0,) * 5)
        seen = tuple(posing.Observed(np.arange(3), np.full((3, 2), 4.0), np.zeros((3, 2))) for _ in range(3))
        return posing.Registered((0, 1, 2), rig.viewmats, (lens,) * 3, np.eye(3), seen, 0.5)

    def marked(kind: str) -> Any:
        more = {"raw": 0, "enhanced": 1, "denoised": 2}[kind]
        return lambda dark, seed: (
            np.round(255 * view.numpy()).astype(np.uint8) + np.uint8(70 * (seed == 5) * more) for view in dark
        )

    monkeypatch.setattr(posing, "register", register)
    monkeypatch.setattr(posing, "SEEN", {kind: marked(kind) for kind in ("raw", "enhanced", "denoised")})
    for k in range(3):
        write_png(tmp_path / "photos" / f"{k}.png", np.full((30, 40, 3), code + k, np.uint8))
    said = io.StringIO()
    record = posing.poses(
        tmp_path / "set", PosesConfig(photographs=tmp_path / "photos", seed=5, **asked), Console(stream=said)
    )
    pictures, mapper = found
    assert given["mapper"] == mapper
    assert given["shown"] == [code + k + 70 * ["raw", "enhanced", "denoised"].index(pictures) for k in range(3)]
    assert {name: record[name] for name in ("dark", "pictures", "mapper")} == {
        "dark": code == 9, "pictures": pictures, "mapper": mapper
    }  # fmt: skip
    for k in range(3):
        assert (np.round(255 * read_png(tmp_path / "set" / "images" / f"{k}.png")) == code + k).all()
    told = "the photographs are dark: cameras are from denoised pictures; --pictures raw" in said.getvalue()
    assert told is (code == 9 and "pictures" not in asked)


def test_only_the_pictures_that_may_be_looked_at_belong_to_the_code(tmp_path: Path) -> None:
    def network(pictures: Any) -> bool:
        return "novags/methods/nova/denoiser.py" in PosesConfig(photographs=tmp_path, pictures=pictures).code.files

    assert {kind: network(kind) for kind in ("auto", "raw", "enhanced", "denoised")} == {
        "auto": True, "raw": False, "enhanced": False, "denoised": True
    }  # fmt: skip


@pytest.mark.parametrize("name", ["pictures", "mapper"])
def test_kinds_that_are_not_there_are_named(name: str, tmp_path: Path) -> None:
    wrong: dict[str, Any] = {name: "bright"}
    with pytest.raises(ValueError, match=rf"{name} of poses must be one of .*(raw|global).*, got 'bright'"):
        PosesConfig(photographs=tmp_path, **wrong)
