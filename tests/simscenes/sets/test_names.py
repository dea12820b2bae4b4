"""Claims about the names of views: whatever photographs are called, their views have names that work everywhere."""

import json
import unicodedata
from pathlib import Path

import cv2
import numpy as np
import pytest

from simscenes import load_set, orbit_rig, write_cameras
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.names import NAME_BYTES, check_names, file_of, numbered, safe_name, view_names
from simscenes.sets.writers.export import export_blender

ODD = [
    "a.png", "a-b.png", "photo.png", "photo (1).png", "A.png", "b.png", "b.jpg", "new\nline.png", "\x1b[31mred.png",
    "line\u2028end.png", " lead.png", ".hidden.png", "..png", "tab\there.png", "back\\slash.png", "Ünïcode 日本.png",
    "x" * 250 + ".png", "x" * 250 + ".PNG", "ü" * 120 + ".png", "a.b.c.png", "#50%.png", "[bold].png",
    "STRASSE.png", "straße.png",
]  # fmt: skip


def folder_of(folder: Path, files: list[str], content: list[str] | None = None) -> Path:
    """Photographs, the k-th of brightness 10 k, seen by the k-th camera of an orbit."""
    rig = orbit_rig(len(files), 40, 30, 55, radius=2.0)
    for k, name in enumerate(files):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(".png", np.full((30, 40, 3), 10 * k, np.uint8))
        assert done
        path.write_bytes(data.tobytes())
    poses = opencv_to_opengl(rig.viewmats)
    frames = [
        {"file_path": name, "transform_matrix": pose.tolist()}
        for name, pose in zip(content or files, poses, strict=True)
    ]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 30.0, "frames": frames}))
    return folder


def test_any_file_names_give_views_that_keep_their_images_and_cameras(tmp_path: Path) -> None:
    files = [*ODD, "one/x.png", "two/x.png"]
    rig = orbit_rig(len(files), 40, 30, 55, radius=2.0)
    views = load_set(folder_of(tmp_path / "set", files))
    assert len(views) == len(files)
    for i, name in enumerate(views.names):
        k = int(views.image(i)[0, 0, 0]) // 10
        assert views.files[i] == tmp_path / "set" / files[k]
        assert np.allclose(views.rig.viewmats[i], rig.viewmats[k], atol=1e-12)
        assert views.renamed.get(name, files[k]) == files[k]
    out = tmp_path / "out"
    write_cameras(out, views.names, views.rig)  # refuses names that files cannot have
    for name in views.names:
        (out / "images").mkdir(exist_ok=True)
        cv2.imwrite(str(out / "images" / file_of(name)), np.zeros((30, 40, 3), np.uint8))
    again = load_set(out)
    assert again.names == views.names
    assert again.renamed == {}
    assert np.allclose(again.rig.viewmats, views.rig.viewmats, atol=1e-12)
    listed = [(out / f"{kind}_list.txt").read_text(encoding="utf-8") for kind in ("train", "test")]
    assert sorted("".join(listed).splitlines()) == sorted(map(file_of, views.names))
    held_out = sorted(map(file_of, views.names))[::8]  # as other loaders choose them
    assert listed[1].splitlines() == held_out == [file_of(views.names[i]) for i in views.test_indices]
    (out / "transforms.json").unlink()
    assert load_set(out).names == views.names  # from the COLMAP model
    with pytest.warns(UserWarning, match="near and far of the views of .* not known.*keeps the world unchanged"):
        folder = export_blender(views, tmp_path / "blender")
    exported = json.loads((folder / "transforms_train.json").read_text())
    assert all((tmp_path / "blender" / f"{frame['file_path']}.png").is_file() for frame in exported["frames"])


def test_names_are_safe_short_and_differ_even_without_case() -> None:
    names = view_names([Path("set") / name for name in ODD])
    assert len({unicodedata.normalize("NFC", name).casefold() for name in names}) == len(names)
    for name in names:
        assert safe_name(name) == name
        assert len(name.encode()) <= NAME_BYTES
        assert name.splitlines() == [name]
        assert not name.startswith((".", " "))
    check_names(sorted(names, key=file_of), len(names))


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["x/a.png", "y/b.png", "z/c.png"], ["a", "b", "c"]),
        (["x/a.png", "y/b.png", "z/A.png"], ["x_a", "y_b", "z_A"]),
        (["x/a.png", "x/b.png", "x/a.jpg"], ["a~2", "b", "a"]),
    ],
)
def test_views_are_named_by_their_folders_only_where_stems_are_alike(files: list[str], names: list[str]) -> None:
    assert view_names([Path("set") / file for file in files]) == names


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a", "b/c"], r"must be safe as file names, got 'b/c': 'b_c' would be"),
        (["a", "b", "a"], "must be different and sorted"),
        (["a", "c", "b"], "must be different and sorted"),
        (["a", "b", "b"], "must be different and sorted"),
    ],
)
def test_no_name_of_a_set_may_be_unsafe_or_out_of_order(names: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        check_names(names, len(names))


def test_ordinary_names_stay_as_they_are_and_in_their_order(tmp_path: Path) -> None:
    """Rationale: results of earlier captures are found by these names."""
    assert load_set(folder_of(tmp_path, [f"images/{k:04d}.png" for k in range(10)])).names == tuple(numbered(10))
    assert view_names([Path("cam0/0.png"), Path("cam1/0.png"), Path("cam1/1.png")]) == ["cam0_0", "cam1_0", "cam1_1"]


def test_numbers_of_views_have_as_many_digits_as_their_order_needs() -> None:
    for count in (1, 9999, 10_000, 10_001, 100_001):
        names = numbered(count)
        assert names[0].endswith("0000")
        check_names(names, count)
    assert numbered(10_000)[-1] == "9999"


def test_a_photograph_is_found_in_either_form_of_unicode(tmp_path: Path) -> None:
    """Rationale: macOS stores names decomposed, whatever a camera file lists."""
    stored = [unicodedata.normalize("NFD", f"é{k}.png") for k in range(2)]
    listed = [unicodedata.normalize("NFC", name) for name in stored]
    assert stored != listed
    assert len(load_set(folder_of(tmp_path, stored, listed))) == 2


def test_spaces_in_the_names_of_a_text_model_are_kept(tmp_path: Path) -> None:
    import pycolmap

    names = ["photo (1)", "photo (2)", "photo"]
    rig = orbit_rig(3, 40, 30, 55, radius=2.0)
    write_cameras(tmp_path, names, rig)
    (tmp_path / "transforms.json").unlink()
    model = tmp_path / "sparse" / "0"
    pycolmap.Reconstruction(str(model)).write_text(str(model))
    for file in model.glob("*.bin"):
        file.unlink()
    (tmp_path / "images").mkdir()
    for k, name in enumerate(names):
        cv2.imwrite(str(tmp_path / "images" / file_of(name)), np.full((30, 40, 3), 10 * k, np.uint8))
    views = load_set(tmp_path)
    assert views.names == tuple(names)
    assert [int(views.image(i)[0, 0, 0]) for i in range(3)] == [0, 10, 20]
    assert np.allclose(views.rig.viewmats, rig.viewmats, atol=1e-12)


def test_a_file_listed_twice_is_refused(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png", "b.png"], ["a.png", "./a.png"])
    with pytest.raises(ValueError, match=r"lists .*a\.png 2 times"):
        load_set(folder)


def test_a_name_that_is_no_text_is_refused_with_the_reason(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["a.png", "b.png"])
    (folder / "b.png").rename(folder / "b\udcff.png")
    listed = (folder / "transforms.json").read_text().replace("b.png", "b\\udcff.png")
    (folder / "transforms.json").write_text(listed)
    with pytest.raises(ValueError, match="not valid UTF-8: rename it"):
        load_set(folder)


@pytest.mark.parametrize(
    ("names", "message"),
    [(["b", "a"], "sorted"), (["a", "a"], "different"), (["a"], "one per camera"), (["a\n", "b"], "safe"),
     (["a", "a-b"], "sorted")],
)  # fmt: skip
def test_names_that_files_cannot_have_are_refused(names: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_names(names, 2)
