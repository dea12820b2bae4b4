"""Files for other readers: what nerfstudio, instant-ngp, nerfbaselines and readers of NeRF-synthetic folders take.

The readers' own conventions are written down here a second time, from their documentation and sources.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from simscenes import EXPORTS, MultiviewSet, export_blender, export_llff, load_set, orbit_rig, write_cameras, write_exr
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.geometry.depth_range import Depths
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.llff import llff_cameras
from simscenes.sets.writers.camera_files import write_json
from simscenes.sets.writers.neighbours import DepthLoss, instant_ngp_box, write_depth

SIZE = (24, 20)  # width, height


def sphere(rig, i, center, radius):
    """z-depth and distance [h,w] of a sphere; inf beside it."""
    x, y = np.meshgrid(np.arange(rig.width) + 0.5, np.arange(rig.height) + 0.5)
    K, c2w = rig.Ks[i], np.linalg.inv(rig.viewmats[i])
    local = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    ray, o = local @ c2w[:3, :3].T, c2w[:3, 3] - center
    a, b, c = (ray**2).sum(-1), ray @ o, o @ o - radius**2
    under = b * b - a * c
    z = np.where(under > 0, (-b - np.sqrt(np.maximum(under, 0))) / a, np.inf).astype(np.float32)
    return z, (z * np.linalg.norm(local, axis=-1)).astype(np.float32)


def make_set(folder: Path, *, size: float = 1.0, center=(0.0, 0.0, 0.0), scene="tabletop:2", photographs=False):
    """A sphere before nothing, in a world of any size and place, made without a renderer."""
    center = np.array(center)
    rig = orbit_rig(9, *SIZE, 50, target=center, radius=3.0 * size, elevation_deg=30)
    names = [f"{i:04d}" for i in range(9)]
    rng = np.random.default_rng(0)
    for i, name in enumerate(names):
        z, distance = sphere(rig, i, center, size)
        write_png(folder / "images" / f"{name}.png", rng.integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8))
        zero = np.zeros_like(z)
        channels = {c: zero for c in ("R", "G", "B", "N.X", "N.Y", "N.Z", "Ng.X", "Ng.Y", "Ng.Z")}
        channels |= {f"{k}.{c}": zero for k in ("albedo", "var") for c in "RGB"} | {"Z": z, "distance": distance}
        if not photographs:
            ids = {n: np.isfinite(z).astype(np.uint32) for n in ("id", "material")}
            write_exr(folder / "gt" / f"{name}.exr", channels | ids)
            write_depth(folder / "depths" / f"{name}.png", z)
    directions = rng.normal(size=(60, 3))
    xyz = center + size * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    facing = np.einsum("cpi,pi->cp", rig.positions[:, None] - xyz, xyz - center) > 0
    rgb = rng.integers(0, 256, (60, 3), dtype=np.uint8)
    points = SparsePoints.seen(rig, xyz, rgb, facing, exact=True)
    write_cameras(folder, names, rig, points=points, depth_dir=None if photographs else "depths", scene=scene)
    if not photographs:
        write_json(folder / "set.json", {"scene": scene})
    return load_set(folder), points


@pytest.fixture
def mkdirs(tmp_path: Path) -> Path:
    for name in ("gt", "images", "depths"):
        (tmp_path / name).mkdir()
    return tmp_path


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points and colours of a binary PLY by its own header."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + 11
    lines = data[:end].decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = int(lines[2].split()[2])
    kinds = {"double": "<f8", "float": "<f4", "uchar": "u1"}
    fields = [(name, kinds[kind]) for _, kind, name in (line.split() for line in lines[3:-1])]
    table = np.frombuffer(data[end:], np.dtype(fields))
    assert len(table) == count
    return np.stack([table[c] for c in "xyz"], -1), np.stack([table[c] for c in ("red", "green", "blue")], -1)


def test_nerfstudio_finds_points_and_depths_in_the_world_of_its_poses(mkdirs: Path) -> None:
    views, points = make_set(mkdirs, size=0.7, center=(4.0, -3.0, 2.0))
    meta = json.loads((mkdirs / "transforms.json").read_text())
    xyz, rgb = read_ply(mkdirs / meta["ply_file_path"])
    assert np.array_equal(xyz, points.xyz)
    assert np.array_equal(rgb, points.rgb)
    assert all("depth_file_path" in frame for frame in meta["frames"])  # for all frames or for none
    for frame in meta["frames"]:
        codes = cv2.imread(str(mkdirs / frame["depth_file_path"]), cv2.IMREAD_ANYDEPTH)
        assert codes.dtype == np.uint16
        z = views.geometry(views.names.index(Path(frame["file_path"]).stem))["z"]
        seen = np.isfinite(z)
        depth = codes.astype(np.float64) * 0.001  # its depth_unit_scale_factor
        assert np.abs(depth[seen] - z[seen]).max() <= 0.0005001
        assert not depth[~seen].any()
        # unprojected with its own conventions (OpenGL camera to world) the depths lie on the sphere
        c2w = np.array(frame["transform_matrix"])
        v, u = np.nonzero(seen)
        x, y = (u + 0.5 - meta["cx"]) / meta["fl_x"], (v + 0.5 - meta["cy"]) / meta["fl_y"]
        world = (np.stack([x, -y, -np.ones(len(u))]) * depth[seen]).T @ c2w[:3, :3].T + c2w[:3, 3]
        assert np.abs(np.linalg.norm(world - [4.0, -3.0, 2.0], axis=1) - 0.7).max() < 0.003


def test_depth_that_sixteen_bits_cannot_hold_is_unknown(tmp_path: Path) -> None:
    write_depth(tmp_path / "z.png", np.array([[np.inf, 65.535, 65.54, 0.0004]], np.float32))
    assert cv2.imread(str(tmp_path / "z.png"), cv2.IMREAD_ANYDEPTH).tolist() == [[0, 65535, 0, 0]]


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.0, ""),
        (0.1, ""),
        (0.01, "few steps between the depths of 0.02 and 0.06 of this set.* scaled by 1.7 would have 100"),
        (15.0, "hold depths up to 65.536: 40% of the depths are beyond and unknown there.* scaled by 0.66 would fit"),
        (1000.0, "100% of the depths are beyond"),
    ],
)
def test_depths_that_the_png_files_cannot_hold_are_said(factor: float, said: str) -> None:
    views = [np.array([[np.inf, 2.0], [3.0, 4.0]]), np.array([[5.0, 6.0]]), np.full((1, 2), np.inf)]
    lost = DepthLoss()
    for z in views:
        lost.add((factor * z).astype(np.float32))
    found = lost.said()
    assert re.search(said, found) if said else found == ""


def test_a_set_without_points_names_none_and_removes_old_ones(mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    write_cameras(mkdirs, views.names, views.rig)
    assert "ply_file_path" not in json.loads((mkdirs / "transforms.json").read_text())
    assert not (mkdirs / "points3D.ply").exists()


@pytest.mark.parametrize(("size", "center"), [(0.01, (0, 0, 0)), (1.0, (30.0, -5.0, 2.0)), (400.0, (0, 0, 1e4))])
def test_instant_ngp_finds_cameras_and_scene_inside_its_box(mkdirs: Path, size, center) -> None:
    views, points = make_set(mkdirs, size=size, center=center)
    meta = json.loads((mkdirs / "transforms.json").read_text())
    assert meta["aabb_scale"] in (1, 2, 4, 8, 16, 32, 64, 128)
    poses = np.array([frame["transform_matrix"] for frame in meta["frames"]])
    inside = [x * meta["scale"] + np.array(meta["offset"]) for x in (poses[:, :3, 3], points.xyz)]
    for places in inside:  # nerf_matrix_to_ngp; the cube is the same for any order of the axes
        assert np.abs(places - 0.5).max() <= meta["aabb_scale"] / 2
    assert meta["aabb_scale"] == 1  # a sphere that cameras circle is not a background
    assert np.ptp(inside[0], axis=0).max() > 0.5  # and is not lost in the cube


def test_nerfstudio_finds_both_focal_lengths_where_it_reads_for_instant_ngp(tmp_path: Path) -> None:
    """Its reader of that name asks for both of these angles, and takes fy for fx without them."""
    rig = orbit_rig(3, *SIZE, 50, radius=3.0)
    Ks = rig.Ks.copy()
    Ks[:, 1, 1] *= 1.1
    write_cameras(tmp_path, ["a", "b", "c"], replace(rig, Ks=Ks))
    meta = json.loads((tmp_path / "transforms.json").read_text())
    for angle, degrees, size, focal in (
        ("camera_angle_x", "x_fov", SIZE[0], Ks[0, 0, 0]),
        ("camera_angle_y", "y_fov", SIZE[1], Ks[0, 1, 1]),
    ):
        assert 0.5 * size / np.tan(0.5 * meta[angle]) == pytest.approx(focal)
        assert 0.5 * size / np.tan(0.5 * np.radians(meta[degrees])) == pytest.approx(focal)


@pytest.mark.parametrize("layout", sorted(EXPORTS))
def test_cameras_that_a_layout_cannot_hold_are_known_before_anything_is_written(layout: str, mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    Ks = views.rig.Ks.copy()
    Ks[4, 1, 1] *= 1.003
    EXPORTS[layout].check(views.rig)
    with pytest.raises(ValueError, match=r"square pixels|view 4 has 25\.\d+ and 25\.\d+ px"):
        EXPORTS[layout].check(replace(views.rig, Ks=Ks))


def test_a_far_background_grows_the_box_and_not_the_scale() -> None:
    centers = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    near = np.random.default_rng(0).uniform(-0.5, 0.5, (1000, 3))
    alone, far = (instant_ngp_box(centers, np.concatenate([near, [[x, 0, 0]]])) for x in (0.9, 30.0))
    assert far["scale"] == pytest.approx(alone["scale"], rel=1e-6)
    assert (alone["aabb_scale"], far["aabb_scale"]) == (1, 32)
    remote = instant_ngp_box(centers, np.concatenate([near, [[1e4, 0, 0]]]))
    assert remote["aabb_scale"] == 128
    assert 1e4 * remote["scale"] + remote["offset"][0] == pytest.approx(0.5 + 64)
    assert instant_ngp_box(centers, np.zeros((0, 3)))["aabb_scale"] == 16
    assert instant_ngp_box(np.zeros((1, 3)), np.zeros((0, 3)))["scale"] == 0.9


@pytest.mark.parametrize(("size", "center"), [(0.01, (0, 0, 0)), (1.0, (30.0, -5.0, 2.0)), (400.0, (0, 0, 1e4))])
def test_the_blender_scene_lies_between_near_2_and_far_6_about_the_origin(mkdirs: Path, size, center) -> None:
    views, points = make_set(mkdirs, size=size, center=center)
    folder = export_blender(views, mkdirs / "blender")
    for part in ("train", "test"):
        meta = json.loads((folder / f"transforms_{part}.json").read_text())
        focal = 0.5 * meta["w"] / np.tan(0.5 * meta["camera_angle_x"])
        for frame in meta["frames"]:
            i, c2w = views.names.index(Path(frame["file_path"]).name), np.array(frame["transform_matrix"])
            z = views.geometry(i)["z"] * meta["scene_scale"]
            v, u = np.nonzero(np.isfinite(z))
            x, y = (u + 0.5 - meta["w"] / 2) / focal, (v + 0.5 - meta["h"] / 2) / focal
            world = (np.stack([x, -y, -np.ones(len(u))]) * z[v, u]).T @ c2w[:3, :3].T + c2w[:3, 3]
            reach = np.linalg.norm(world - c2w[:3, 3], axis=1)
            assert 2 <= z[v, u].min()
            assert reach.max() <= 6
            assert np.abs(np.linalg.norm(world, axis=1) - size * meta["scene_scale"]).max() < 0.2
    assert np.abs(np.linalg.norm(world, axis=1)).max() < 2


def test_near_is_the_least_depth_and_far_the_largest_distance(mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    z, distance = np.array([sphere(views.rig, i, np.zeros(3), 1.0) for i in range(9)]).swapaxes(0, 1)
    found = Depths.of(views)
    assert (found.nearest, found.farthest) == (z.min(), distance[np.isfinite(distance)].max())


def test_poses_for_llff_are_read_back_as_the_cameras(mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    viewmats, sizes = llff_cameras(export_llff(views, mkdirs / "llff") / "poses_bounds.npy")
    np.testing.assert_allclose(viewmats, views.rig.viewmats, atol=1e-9)
    assert sizes[0] == (SIZE[1], SIZE[0], pytest.approx(views.rig.Ks[0, 0, 0]))


def test_every_view_of_the_blender_scene_is_listed_and_written_in_its_part(mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    folder = export_blender(views, mkdirs / "blender")
    held_out, rest = ["0000", "0008"], [f"000{i}" for i in range(1, 8)]
    for part, names in (("train", rest), ("val", held_out), ("test", held_out)):
        frames = json.loads((folder / f"transforms_{part}.json").read_text())["frames"]
        assert [frame["file_path"] for frame in frames] == [f"./{part}/{name}" for name in names]
        assert sorted(path.stem for path in (folder / part).iterdir()) == names


def test_blender_pictures_are_transparent_where_no_surface_is(mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    folder = export_blender(views, mkdirs / "blender")
    for i in (0, 3):
        picture = cv2.imread(
            str(folder / ("test" if i == 0 else "train") / f"{views.names[i]}.png"), cv2.IMREAD_UNCHANGED
        )
        assert picture.shape == (20, 24, 4)
        seen = np.isfinite(views.geometry(i)["z"])
        assert 50 < seen.sum() < 400
        assert np.array_equal(picture[..., 3], np.where(seen, 255, 0))
        assert np.array_equal(picture[..., 2::-1], views.image(i))


def test_photographs_are_scaled_by_their_points_and_opaque(mkdirs: Path) -> None:
    (mkdirs / "gt").rmdir()
    views, points = make_set(mkdirs, size=50.0, photographs=True)
    folder = export_blender(views, mkdirs / "blender")
    meta = json.loads((folder / "transforms_train.json").read_text())
    for i, view in enumerate(views.rig.viewmats):
        xyz = points.xyz[points.point[points.view == i]]
        z = (xyz @ view[2, :3] + view[2, 3]) * meta["scene_scale"]
        assert 2 <= z.min()
        assert (np.linalg.norm(xyz - views.rig.positions[i], axis=1) * meta["scene_scale"]).max() <= 6
    picture = cv2.imread(str(folder / "train" / "0001.png"), cv2.IMREAD_UNCHANGED)
    assert (picture[..., 3] == 255).all()


def test_a_scene_that_is_deeper_than_three_times_its_nearness_is_said_to_stick_out(mkdirs: Path) -> None:
    views, _ = make_set(mkdirs)
    z, distance = sphere(views.rig, 3, np.zeros(3), 1.0)
    z[0, 0], distance[0, 0] = 0.05, 0.05
    names = ("R", "G", "B", "N.X", "N.Y", "N.Z", "Ng.X", "Ng.Y", "Ng.Z", "albedo.R", "albedo.G", "albedo.B")
    channels = dict.fromkeys((*names, "var.R", "var.G", "var.B"), np.zeros_like(z)) | {"Z": z, "distance": distance}
    write_exr(views.path / "gt" / "0003.exr", channels | dict.fromkeys(("id", "material"), z.astype(bool).astype("u4")))
    with pytest.warns(
        UserWarning, match=r"no scale brings the whole scene between near 2 and far 6.*: 0\.0\d+ % of it"
    ):
        folder = export_blender(views, views.path / "blender")
    assert 1.2 < json.loads((folder / "transforms_train.json").read_text())["scene_scale"] < 1.6


def test_a_scene_that_fits_no_bounds_is_scaled_so_that_the_least_of_it_is_outside() -> None:
    z = [np.geomspace(0.5, 20.0, 2000), np.geomspace(0.7, 30.0, 999)]
    depths = Depths(z=z, distance=z, nearest=0.5, farthest=30.0, center=np.zeros(3))
    scale, _, outside = depths.fit(2.0, 6.0)
    every = np.concatenate(z)

    def share(scale: float) -> float:
        return float(np.mean((every * scale < 2.0) | (every * scale > 6.0)))

    assert outside == share(scale)
    assert outside <= min(share(other) for other in np.geomspace(0.01, 20.0, 2000)) + 2 / every.size


def test_exports_tell_nerfbaselines_how_to_read_them_and_what_the_scene_is_called(mkdirs: Path) -> None:
    views, points = make_set(mkdirs, scene="cornell:3")
    wanted = {"loader": "colmap", "loader_kwargs": {"images_path": "images", "colmap_path": "sparse/0"}}
    info = {"id": "novags", "scene": "cornell:3"}
    assert json.loads((mkdirs / "nb-info.json").read_text()) == {**wanted, **info}
    llff = export_llff(views, mkdirs / "llff")
    assert json.loads((llff / "nb-info.json").read_text()) == {**wanted, **info}
    assert np.allclose(load_set(llff).rig.viewmats, views.rig.viewmats)
    assert len(load_set(llff).points()) == len(points)
    blender = json.loads((export_blender(views, mkdirs / "blender") / "nb-info.json").read_text())
    assert blender == {
        "loader": "nerfbaselines.datasets.blender:load_blender_dataset",
        "loader_kwargs": {},
        "evaluation_protocol": "nerf",
        "type": "object-centric",
        **info,
    }


def test_a_capture_takes_depth_and_alpha_from_the_set_it_was_made_of(mkdirs: Path, tmp_path: Path) -> None:
    views, points = make_set(mkdirs)
    dark = tmp_path / "capture"
    (dark / "images").mkdir(parents=True)
    half = orbit_rig(9, SIZE[0] // 2, SIZE[1] // 2, 50, target=(0, 0, 0), radius=3.0, elevation_deg=30)
    for name in views.names:
        write_png(dark / "images" / f"{name}.png", np.full((10, 12, 3), 7, np.uint8))
    write_cameras(dark, views.names, half)
    capture: MultiviewSet = replace(load_set(dark), meta={})
    folder = export_blender(capture, dark / "blender", truth=views)
    picture = cv2.imread(str(folder / "train" / "0004.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (10, 12, 4)
    assert (picture[..., :3] == 7).all()
    seen = np.isfinite(sphere(half, 4, np.zeros(3), 1.0)[0])
    assert ((picture[..., 3] > 0) != seen).mean() < 0.15  # only along the edge
    assert np.allclose(
        np.load(export_llff(capture, dark / "llff", truth=views) / "poses_bounds.npy")[:, 15:],
        np.load(export_llff(views, mkdirs / "llff") / "poses_bounds.npy")[:, 15:],
    )
    poses = np.array([f["transform_matrix"] for f in json.loads((dark / "transforms.json").read_text())["frames"]])
    assert np.allclose(poses, opencv_to_opengl(views.rig.viewmats))
