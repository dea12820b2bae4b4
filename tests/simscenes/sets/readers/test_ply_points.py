"""Claims about first points that a camera file names: read from any PLY, in the frame of the cameras, or said."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.set import open_source
from simscenes import load_set
from simscenes.sets.readers.ply_points import MOST, read_ply_points
from tests.simscenes.sets.readers.test_entries import folder_of

XYZ = np.random.default_rng(0).normal(0, 0.3, (50, 3)).astype(np.float32)
RGB = np.random.default_rng(1).integers(0, 256, (50, 3), dtype=np.uint8)


def ply(form: str, *, columns: str = "xyz rgb", before: bool = False, count: int = 50) -> bytes:
    """Points as programs write them: open3d (double), nerfstudio (float), with normals, behind another element."""
    order = {"binary_big_endian": ">"}.get(form, "<")
    kinds = {"xyz": [(a, order + "f4", "float") for a in "xyz"], "XYZ": [(a, order + "f8", "double") for a in "xyz"],
             "n": [(f"n{a}", order + "f4", "float") for a in "xyz"],
             "rgb": [(c, "u1", "uchar") for c in ("red", "green", "blue")],
             "rgb16": [(c, order + "u2", "ushort") for c in ("red", "green", "blue")],
             "rgbf": [(c, order + "f4", "float") for c in ("red", "green", "blue")],
             "rgbi": [(c, order + "i4", "int") for c in ("red", "green", "blue")],
             "dc": [(f"f_dc_{i}", order + "f4", "float") for i in range(3)], "": []}  # fmt: skip
    chosen = [column for word in columns.split() for column in kinds[word]]
    table = np.zeros(count, np.dtype([(name, kind) for name, kind, _ in chosen]))
    for i, axis in enumerate("xyz"):
        if axis in (table.dtype.names or ()):
            table[axis] = XYZ[:count, i]
    for i, name in enumerate(("red", "green", "blue")):
        if name in (table.dtype.names or ()):
            table[name] = RGB[:count, i].astype(int) * (257 if "rgb16" in columns else 1)
        if f"f_dc_{i}" in (table.dtype.names or ()):
            table[f"f_dc_{i}"] = (RGB[:count, i] / 255 - 0.5) / 0.28209479177387814
    head = ["ply", f"format {form} 1.0", "comment by a stranger"]
    head += ["element camera 2", "property float view_px", "property int view_id"] * before
    head += [f"element vertex {count}", *(f"property {word} {name}" for name, _, word in chosen)]
    head += ["element face 0", "property list uchar int vertex_indices", "end_header"]
    if form == "ascii":
        rows = [" ".join(repr(v.item()) for v in row) for row in table]
        return "\n".join([*head, *["0.5 1"] * 2 * before, *rows, ""]).encode()
    extra = np.zeros(2, order + "f4").tobytes() + np.zeros(2, order + "i4").tobytes()
    return ("\n".join(head) + "\n").encode() + extra * before + table.tobytes()


def with_rows(rows: bytes) -> bytes:
    """Points in text of which these rows are the first."""
    return ply("ascii", columns="xyz").replace(b"end_header\n", b"end_header\n" + rows)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("columns", ["xyz rgb", "XYZ n rgb", "xyz n rgb16", "xyz rgbf", "xyz rgbi", "xyz dc"])
@pytest.mark.parametrize("before", [False, True])
def test_points_and_colours_come_out_of_any_ply(form: str, columns: str, before: bool, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(ply(form, columns=columns, before=before))
    points = read_ply_points(tmp_path / "a.ply")
    np.testing.assert_allclose(points.xyz, XYZ, rtol=1e-6)
    assert np.abs(points.rgb.astype(int) - RGB).max() <= (1 if "dc" in columns else 0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"solid stl\n", "is not a PLY file"),
        (ply("binary_little_endian")[:-100], "is cut short: it announces 50 points and has 43"),
        (ply("ascii").rsplit(b"\n", 4)[0] + b"\n", "is cut short: it announces 50 points and has 47"),
        (ply("ascii", columns="rgb"), "must have points with x, y and z, it has red, green, blue"),
        (ply("ascii").replace(b"end_header\n", b"end_header\nnan 0 0 1 1 1\n"), "must be finite, 1 of 50 are not"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n", "with plain properties"),
        (ply("ascii").replace(b"property float y", b"property list uchar int y"), "with plain properties.*got .* list"),
        (
            ply("binary_little_endian", before=True).replace(b"property int view_id", b"property list int int view_id"),
            "points must come before elements of lists",
        ),
        (ply("ascii").replace(b"property float x", b"property list uchar int x"), "points, x list, y f4, z f4, red u1"),
        (with_rows(b"0 0 0\n1 1\n"), "point 1 must have 3 numbers, got 2"),
        (with_rows(b"0 0\n1 1 1\n"), "point 0 must have 3 numbers, got 2"),
        (b"ply\nformat zip 1.0\nelement vertex 1\nproperty float x\nend_header\n", "got format zip, 1 points"),
    ],
)
def test_what_is_no_file_of_points_is_refused_with_the_reason(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_ply_points(tmp_path / "a.ply")


def test_a_third_of_a_colour_is_none(tmp_path: Path) -> None:
    whole, file = ply("ascii"), tmp_path / "a.ply"
    lacking = [whole.replace(b"uchar " + name, b"uchar other") for name in (b"red", b"green", b"blue")]
    found = []
    for content in (*lacking, ply("ascii", columns="xyz")):
        file.write_bytes(content)
        found.append(read_ply_points(file).rgb)
    assert len(np.unique(found)) == 1


def test_of_very_many_points_an_even_choice_is_read(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).normal(0, 1, (MOST + 10, 3)).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + rows.tobytes())
    assert len(read_ply_points(tmp_path / "a.ply")) == MOST


@pytest.mark.parametrize("name", ["transforms.json", "transforms_train.json"])
def test_listed_points_are_the_first_points_in_the_frame_of_the_cameras(name: str, tmp_path: Path) -> None:
    """`applied_transform` is of both, so it moves neither."""
    (tmp_path / "sparse_pc.ply").write_bytes(ply("ascii"))
    turned = [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]]
    views = load_set(folder_of(tmp_path, name=name, ply_file_path="sparse_pc.ply", applied_transform=turned))
    points = views.points()
    assert points is not None
    np.testing.assert_allclose(points.xyz, XYZ, rtol=1e-6)
    moved = views.about((1.0, 2.0, 3.0)).points()
    assert moved is not None
    np.testing.assert_allclose(moved.xyz, XYZ - [1, 2, 3], rtol=1e-5)


def test_points_of_another_frame_are_refused(tmp_path: Path) -> None:
    (tmp_path / "far.ply").write_bytes(ply("ascii").replace(b"property float x", b"property float q"))
    with pytest.raises(ValueError, match="must have points with x, y and z"):
        load_set(folder_of(tmp_path, ply_file_path="far.ply")).points()
    rows = "\n".join(f"{x} {y} 5000" for x, y, _ in XYZ)
    (tmp_path / "far.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 50\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + rows + "\n"
    )  # fmt: skip
    with pytest.raises(ValueError, match="must lie in the frame of the cameras, 0 of 50 are in a picture"):
        load_set(folder_of(tmp_path, ply_file_path="far.ply")).points()


@pytest.mark.parametrize(
    ("file", "named", "said"),
    [
        ("sparse_pc.ply", None, "holds points (sparse_pc.ply) that transforms.json does not name"),
        ("colmap/sparse/0/points3D.bin", None, "holds a COLMAP model (colmap/sparse/0) beside transforms.json"),
        (None, "gone.ply", "names a file of first points that is not there (gone.ply)"),
    ],
)
@pytest.mark.parametrize("info", [None, "nerfstudio/poster", "novags"])
def test_points_that_are_not_read_are_said(
    file: str | None, named: str | None, said: str, info: str | None, tmp_path: Path
) -> None:
    """nerfbaselines writes nb-info.json into data sets of others, and ours without a model have one as well."""
    if info is not None:
        (tmp_path / "nb-info.json").write_text(json.dumps({"id": info, "loader": "nerfstudio", "loader_kwargs": None}))
    if file is not None:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_bytes(ply("ascii"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        views = load_set(folder_of(tmp_path, **({} if named is None else {"ply_file_path": named})))
    assert [said in str(w.message) for w in caught] == [True]
    assert views.points() is None


def test_other_points_make_another_set(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(ply("ascii"))
    folder = folder_of(tmp_path, ply_file_path="a.ply")
    before = open_source(folder, Console()).digest()
    (folder / "a.ply").write_bytes(ply("ascii", count=40))
    assert open_source(folder, Console()).digest() != before
    assert json.loads((folder / "transforms.json").read_text())["ply_file_path"] == "a.ply"
