"""A rendered set: complete, repeatable bit by bit, resumed where it was interrupted."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

from simscenes import Rig, default_rig, load_set, orbit_rig, read_exr, render_set

Job = Callable[..., Any]


def exr_arrays(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    return {p.stem: read_exr(p)[0] for p in sorted((folder / "gt").glob("*.exr"))}


def same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[k], b[k]) for k in a)


def test_a_set_is_complete_consistent_and_readable(small_job: Job, tmp_path: Path) -> None:
    calls: list[tuple[int, int, str]] = []
    done = small_job(tmp_path / "set", progress=lambda *a: calls.append(a))
    assert done.kind == "rendered"
    assert [c[0] for c in calls] == sorted(c[0] for c in calls)
    assert {c[0] for c in calls} == {0, 1, 2, 3}
    rendering = [what for done, _, what in calls if done == 1]
    assert rendering[0].startswith("view 0001, 0%, about")
    assert rendering[-1].startswith("view 0001, 100%")
    assert all("s left" in what for what in rendering)
    meta = done.meta
    assert set(meta["seconds"]) == {"load", "plan", "predict", "radiance", "geometry", "write"}
    assert meta["predicted_seconds"] > 0
    assert meta["integrator"] == {"type": "volpath", "max_depth": 64, "rr_depth": 2}
    assert {e["name"] for e in meta["plan"]["effects"]} >= {"indirect light", "polarisation"}
    assert meta["peak_bytes"] > 1e7
    assert meta["shapes"] == ["plane", "ball", "lamp"]
    image, exact = done.image(0), done.radiance(0) * meta["exposure_scale"]
    assert image.shape == (13, 17, 3)
    from sensor_model import linear_to_srgb

    assert np.abs(image / 255 - linear_to_srgb(exact.clip(0, 1))).max() < 0.51 / 255
    geometry, points = done.geometry(1), done.points()
    assert geometry is not None
    assert geometry["normals"].shape == (13, 17, 3)
    assert points is not None
    on_surface = np.minimum(np.abs(points.xyz[:, 2]), np.abs(np.linalg.norm(points.xyz - [0, 0, 1], axis=1) - 1))
    assert np.median(on_surface) < 1e-5
    header = read_exr(tmp_path / "set" / "gt" / "0001.exr")[1]
    assert np.allclose(header["worldToCamera"], done.rig.viewmats[1], atol=1e-6)


@pytest.mark.parametrize("quality", [{}, {"spp": None, "target_error": 0.05}], ids=["spp", "target"])
def test_interrupted_reordered_and_repeated_renders_are_bit_identical(
    small_job: Job, quality: dict, tmp_path: Path
) -> None:
    rig = orbit_rig(3, 17, 13, 60, target=(0, 0, 0.8), radius=4.0)
    small_job(tmp_path / "a", rig, **quality)
    first = exr_arrays(tmp_path / "a")

    kept = tmp_path / "a" / "gt" / "0000.exr"
    before = kept.stat().st_mtime_ns
    (tmp_path / "a" / "gt" / "0001.exr").unlink()
    (tmp_path / "a" / "gt" / "0002.exr").write_bytes(b"cut short")
    (tmp_path / "a" / "set.json").unlink()
    small_job(tmp_path / "a", rig, **quality)
    assert kept.stat().st_mtime_ns == before  # a finished view is not rendered again
    assert all(same(first[k], v) for k, v in exr_arrays(tmp_path / "a").items())

    order = [2, 0, 1]
    shuffled = Rig(viewmats=rig.viewmats[order], Ks=rig.Ks[order], width=17, height=13)
    small_job(tmp_path / "b", shuffled, **quality)
    second = exr_arrays(tmp_path / "b")
    assert all(same(first[f"{i:04d}"], second[f"{k:04d}"]) for k, i in enumerate(order))


def test_an_interrupted_render_says_what_it_cost_in_all(small_job: Job, tmp_path: Path) -> None:
    def stop(done: int, total: int, what: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        small_job(tmp_path, progress=stop)
    spent = json.loads((tmp_path / "seconds.json").read_text())["seconds"]
    assert spent["radiance"] > 0
    file = tmp_path / "seconds.json"
    file.write_text(file.read_text().replace(str(spent["radiance"]), "1e6"))
    done = small_job(tmp_path)
    assert 1e6 < done.meta["seconds"]["radiance"] < 1e6 + 600
    assert not (tmp_path / "seconds.json").exists()
    other = small_job(tmp_path, seed=1)
    assert other.meta["seconds"]["radiance"] < 600


def test_the_seed_varies_the_noise_of_every_view_and_the_places_of_the_points(small_job: Job, tmp_path: Path) -> None:
    one, other = (small_job(tmp_path / str(seed), seed=seed, spp=2) for seed in (1, 0))
    assert all(not np.array_equal(one.radiance(i), other.radiance(i)) for i in range(3))
    assert not np.array_equal(one.points().xyz[:5], other.points().xyz[:5])


def test_tracks_reproject_and_show_the_true_surface(small_job: Job, tmp_path: Path) -> None:
    """COLMAP's files through pycolmap, cameras through transforms.json and ten lines of our own: they must agree."""
    small_job(tmp_path)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    cameras = json.loads((tmp_path / "transforms.json").read_text())
    poses = {Path(f["file_path"]).name: np.array(f["transform_matrix"]) for f in cameras["frames"]}
    count = 0
    for image in model.images.values():
        c2w = poses[image.name]
        z = read_exr(tmp_path / "gt" / f"{Path(image.name).stem}.exr")[0]["Z"]
        for point in image.points2D:
            xyz = model.points3D[point.point3D_id].xyz
            x, y, back = c2w[:3, :3].T @ (xyz - c2w[:3, 3])  # OpenGL: y up, looking along -z
            place = np.array([cameras["cx"] - cameras["fl_x"] * x / back, cameras["cy"] + cameras["fl_y"] * y / back])
            assert np.abs(place - point.xy).max() < 1e-4
            assert np.abs(image.project_point(xyz) - point.xy).max() < 1e-4
            u, v = np.floor(place).astype(int)
            near = z[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
            assert -back <= 1.05 * near.max()  # not behind what the view shows there
            count += 1
    assert count > 100
    assert min(p.track.length() for p in model.points3D.values()) >= 2


def test_other_layouts_are_written_on_request_also_beside_a_finished_set(small_job: Job, tmp_path: Path) -> None:
    small_job(tmp_path)
    assert not (tmp_path / "blender").exists()
    stamp = (tmp_path / "set.json").stat().st_mtime_ns
    done = small_job(tmp_path, export=("blender", "llff"))
    assert (tmp_path / "set.json").stat().st_mtime_ns == stamp
    frames = json.loads((tmp_path / "blender" / "transforms_train.json").read_text())["frames"]
    assert len(frames) == len(done.train_indices)
    assert np.load(tmp_path / "llff" / "poses_bounds.npy").shape == (3, 17)
    assert len(load_set(tmp_path)) == 3
    with pytest.raises(ValueError, match="blender"):
        small_job(tmp_path, export=("blend",))


def test_another_process_renders_the_same_bits(small_job: Job, tmp_path: Path) -> None:
    """Mitsuba's own optimizer orders merged shapes, and so lights, by memory address; we must not let it."""
    small_job(tmp_path / "a")
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1])!r})\n"
        f"from pathlib import Path; from conftest import small_job; small_job(Path({str(tmp_path / 'b')!r}))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    first, second = exr_arrays(tmp_path / "a"), exr_arrays(tmp_path / "b")
    assert first.keys() == second.keys()
    assert all(same(first[k], second[k]) for k in first)
    digests = [json.loads((tmp_path / d / "set.json").read_text())["digest"] for d in "ab"]
    assert digests[0] == digests[1]


def test_a_finished_set_is_not_rendered_again_unless_something_changed(small_job: Job, tmp_path: Path) -> None:
    small_job(tmp_path)
    stamp = (tmp_path / "set.json").stat().st_mtime_ns
    small_job(tmp_path)
    assert (tmp_path / "set.json").stat().st_mtime_ns == stamp
    first = exr_arrays(tmp_path)
    small_job(tmp_path, seed=1)
    second = exr_arrays(tmp_path)
    assert not np.array_equal(first["0000"]["R"], second["0000"]["R"])
    assert np.array_equal(first["0000"]["Z"], second["0000"]["Z"])


def test_fewer_views_remove_the_stale_ones(small_job: Job, tmp_path: Path) -> None:
    small_job(tmp_path, export=("blender", "llff"))
    rig = orbit_rig(2, 17, 13, 60, target=(0, 0, 0.8), radius=4.0)
    assert len(small_job(tmp_path, rig, export=("llff",))) == 2
    for folder in ("gt", "images", "depths", "llff/images"):
        assert len(list((tmp_path / folder).iterdir())) == 2
    assert len(np.load(tmp_path / "llff" / "poses_bounds.npy")) == 2
    assert not (tmp_path / "blender").exists()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (2, 1), (7, 3)])
def test_tiny_images_render(small_job: Job, width: int, height: int, tmp_path: Path) -> None:
    """Plainly, and with a plan and towards an error, which measure what they see in the image."""
    rig = orbit_rig(2, width, height, 20, target=(0, 0, 0.8), radius=4.0)
    plain = small_job(tmp_path / "plain", rig, spp=256)
    planned = small_job(tmp_path / "planned", rig, spp=None, target_error=0.05, plan="auto")
    for done in (plain, planned):
        assert done.radiance(1).shape == (height, width, 3)
    assert planned.radiance(1).mean() == pytest.approx(plain.radiance(1).mean(), rel=0.3)


def test_fireflies_are_said_in_the_set_and_on_the_way(
    ball_on_plane: Callable[[], dict[str, Any]], tmp_path: Path
) -> None:
    """A ball lit through glass by a tiny bright lamp: few paths find it, and those that do are blinding."""
    lamp = {"type": "sphere", "center": [0, 0, 3], "radius": 0.01}
    lamp["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 1e5}}
    glass = {"type": "sphere", "center": [0, 0, 3], "radius": 0.5, "bsdf": {"type": "dielectric"}}
    scene, said = ball_on_plane() | {"tiny": lamp, "shell": glass}, []
    rig = orbit_rig(2, 32, 32, 60, target=(0, 0, 0.8), radius=4.0)
    done = render_set(scene, rig, tmp_path, spp=16, plan="rgb", progress=lambda a, b, what: said.append(what))
    count = sum(view["fireflies"] for view in done.meta["views"].values())
    assert count > 0
    assert re.fullmatch(rf"images; .*; {count} fireflies, see set.json", said[-1])


@pytest.mark.parametrize(
    ("quality", "message"),
    [({"spp": 1}, "spp"), ({"target_error": 0.0}, "target_error"), ({"spp": 4, "target_error": 0.1}, "not both")],
)
def test_impossible_quality_is_refused(quality: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        render_set("cornell", None, tmp_path, **quality)


def test_unknown_scenes_are_refused_with_the_list(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="tabletop"):
        render_set("tabeltop", None, tmp_path)
    with pytest.raises(ValueError, match="seed"):
        default_rig("cornell:x", 2, 4, 4)


def test_load_set_of_a_rendered_set_needs_no_mitsuba(small_job: Job, tmp_path: Path) -> None:
    small_job(tmp_path)
    code = f"import sys, simscenes; s = simscenes.load_set({str(tmp_path)!r}); s.radiance(0); s.geometry(1); s.points(); print('mitsuba' in sys.modules)"  # noqa: E501
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
    assert load_set(tmp_path).meta["scene"] == "custom"


def test_a_layout_that_cannot_hold_the_cameras_is_refused_before_anything_is_rendered(
    small_job: Job, tmp_path: Path
) -> None:
    rig = orbit_rig(3, 17, 13, 60, target=(0, 0, 0.8), radius=4.0)
    off_centre = rig.Ks + [[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]
    with pytest.raises(ValueError, match="a centred principal point"):
        small_job(tmp_path, replace(rig, Ks=off_centre), export=("blender",))
    assert not (tmp_path / "gt").exists()
