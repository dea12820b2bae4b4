"""On which files the cameras of photographs depend."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from novags.testbed.console.terminal import Console
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
