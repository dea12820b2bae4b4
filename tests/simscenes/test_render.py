"""Rendered truth: geometry against analytic surfaces, variance against many seeds, repeatability, resuming."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

from simscenes import Rig, default_rig, load_set, orbit_rig, read_exr, render_set
from simscenes.backend import activate, using_variant
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.render.geometry import geometry_channels
from simscenes.render.passes import Passes, count_fireflies, split_passes
from simscenes.render.radiance import Method, View
from simscenes.render.sensors import sensor_dict
from simscenes.rigs import intrinsics, look_at

GRAY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}}


def ball_on_plane() -> dict[str, Any]:
    """Unit sphere resting on z = 0, a small lamp, a bright sky: two lights and one material shared by two shapes."""
    ref = {"type": "ref", "id": "paint"}
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 9.0}}
    with using_variant() as mi:
        lamp = mi.ScalarTransform4f().translate([1, -1, 4]).rotate([1, 0, 0], 180).scale(0.4)
    return {
        "type": "scene",
        "paint": GRAY,
        "plane": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(3), "bsdf": ref},
        "ball": {"type": "sphere", "center": [0, 0, 1], "radius": 1.0, "bsdf": ref},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": glow},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.3, 0.4]}},
    }  # fmt: skip


def view(width: int = 41, height: int = 31) -> Rig:
    K = intrinsics(width, height, 50)
    K[0, 2] += 3.3
    return Rig(viewmats=look_at((3, -4, 2.5), (0.2, 0.1, 0.8))[None], Ks=K[None], width=width, height=height)


def radiance(
    loaded: LoadedScene, rig: Rig, *, spp: int | None = None, target_error: float | None = None, seed: int = 0
) -> Any:
    mi = activate()
    integrator = mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 2})
    return View(Method(mi, mi.variant(), loaded, integrator, seed=seed), rig, 0).render(spp, target_error)


def analytic(rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distance, z-depth, normal and id (1 plane, 2 ball) of every pixel centre, in float64, from first principles."""
    x, y = np.meshgrid(np.arange(rig.width) + 0.5, np.arange(rig.height) + 0.5)
    directions = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(rig.Ks[0]).T
    c2w = np.linalg.inv(rig.viewmats[0])
    d = directions @ c2w[:3, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    o = c2w[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        t_plane = -o[2] / d[..., 2]
        p = o + t_plane[..., None] * d
        t_plane = np.where((t_plane > 0) & (np.abs(p[..., :2]) <= 3).all(-1), t_plane, np.inf)
        b = d @ (o - [0, 0, 1])
        root = b**2 - (np.sum((o - [0, 0, 1]) ** 2) - 1)
        t_ball = np.where(root > 0, -b - np.sqrt(root), np.inf)
    t = np.minimum(t_plane, t_ball)
    ball = t_ball < t_plane
    normal = np.where(ball[..., None], o + np.where(np.isfinite(t), t, 0)[..., None] * d - [0, 0, 1], [0, 0, 1])
    z = t * (d @ c2w[:3, 2])
    return t, z, normal, np.where(np.isfinite(t), np.where(ball, 2, 1), 0)


def check_geometry(variant: str, rig: Rig) -> None:
    with using_variant(variant) as mi:
        loaded = build_scene(ball_on_plane(), mi)
        assert variant in ("auto", loaded.variant.removesuffix("_rgb"))
        channels = geometry_channels(mi, loaded, rig, 0)
    t, z, normal, number = analytic(rig)
    names = np.array(["", *loaded.shapes])
    assert np.array_equal(names[channels["id"]], np.array(["", "plane", "ball"])[number])
    seen = number > 0
    assert 0.2 < seen.mean() < 1
    assert np.isinf(channels["Z"][~seen]).all()
    assert np.isinf(channels["distance"][~seen]).all()
    assert np.abs(channels["distance"][seen] / t[seen] - 1).max() < 1e-5
    assert np.abs(channels["Z"][seen] / z[seen] - 1).max() < 1e-5
    for name in ("N", "Ng"):
        found = np.stack([channels[f"{name}.{c}"] for c in "XYZ"], -1)
        assert np.abs(found[seen] - normal[seen]).max() < 2e-5
        assert not found[~seen].any()
    albedo = np.stack([channels[f"albedo.{c}"] for c in "RGB"], -1)
    assert np.allclose(albedo[seen], [0.6, 0.4, 0.2], atol=1e-6)
    assert len(np.unique(channels["material"][seen])) == 1


def test_geometry_equals_the_analytic_surfaces() -> None:
    check_geometry("auto", view())


def test_geometry_is_the_same_in_a_scalar_variant() -> None:
    check_geometry("scalar", view(21, 16))


def test_variance_estimate_equals_the_spread_over_many_seeds() -> None:
    """Rationale: the spread of n = 60 independent renders has relative SE sqrt(2/(n-1)) per independent pixel.

    Both in sum over the view, and in each pixel for its 3 x 3 neighbourhood, which shares one variance.
    """
    loaded, rig, n = build_scene(ball_on_plane(), activate()), view(12, 9), 60
    runs = [radiance(loaded, rig, spp=8, seed=k) for k in range(n)]
    means = np.stack([r.mean for r in runs]).astype(np.float64)
    estimates = np.stack([r.variance for r in runs]).astype(np.float64)
    true = means.var(0, ddof=1)
    # Per-seed estimates scatter by themselves; the truth's own error comes from its noisiest pixels.
    each = estimates.mean((1, 2, 3))
    se = np.hypot(each.std(ddof=1) / np.sqrt(n), np.sqrt(2 / (n - 1)) * np.linalg.norm(true) / true.size)
    assert each.mean() == pytest.approx(true.mean(), abs=5 * se)
    assert se < 0.2 * true.mean()
    padded = np.pad(true, ((1, 1), (1, 1), (0, 0)), mode="symmetric")
    around = np.stack([padded[y : y + 9, x : x + 12] for y in range(3) for x in range(3)])
    fourth = np.linalg.norm(around, axis=0) / 9 * np.sqrt(2 / (n - 1))
    pixel = (estimates.mean(0) - around.mean(0)) / np.hypot(estimates.std(0, ddof=1) / np.sqrt(n), fourth).clip(1e-12)
    assert np.abs(pixel).max() < 6  # 324 values whose variances are themselves estimated from skew ones
    assert np.median(estimates.std(0, ddof=1) / estimates.mean(0).clip(1e-12)) < 0.8  # 1.4 if each pixel had its own


def test_samples_in_two_large_passes_are_almost_as_good_as_in_one() -> None:
    """A lamp over a matt floor, direct light: the worst case, where stratified samples gain most by being many.

    Root mean square over 8 seeds of 432 pixels each, whose relative error is some 1 / sqrt(2 * 8 * 432) = 1 %. In four
    passes of 16 the error is 1.33 times that of one pass.
    """
    mi = activate()
    lamp = mi.ScalarTransform4f().translate([0, 0, 6]).rotate([1, 0, 0], 180).scale(1.5)
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 9.0}}
    floor = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(30), "bsdf": GRAY}
    scene = {"type": "scene", "floor": floor, "lamp": {"type": "rectangle", "to_world": lamp, "emitter": glow}}
    loaded, rig = build_scene(scene, mi), view(24, 18)
    integrator = mi.load_dict({"type": "path", "max_depth": 2, "rr_depth": 3})
    ours, whole = [], []
    for seed in range(8):
        method = Method(mi, mi.variant(), loaded, integrator, seed=seed)
        ours.append(View(method, rig, 0).render(64, None).mean)
        sensor = mi.load_dict(
            sensor_dict(mi, rig, 0, loaded) | {"sampler": {"type": "multijitter", "sample_count": 64}}
        )
        image = mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=64, seed=seed)
        whole.append(np.array(image, dtype=np.float64)[..., :3])
    errors = [float(np.sqrt(np.var(images, axis=0, ddof=1).mean())) for images in (ours, whole)]
    assert errors[0] < 1.2 * errors[1]


def test_passes_accumulate_like_numpy() -> None:
    images = np.random.default_rng(0).normal(5, 1, (6, 4, 3, 3))
    passes = Passes((4, 3))
    for image in images:
        passes.add(image)
    result = passes.result(10)
    assert np.allclose(result.mean, images.mean(0))
    assert np.allclose(passes.variance(), images.var(0, ddof=1) / 6)
    assert np.allclose(result.variance.mean(), images.var(0, ddof=1).mean() / 6)  # pooled, the sum is kept
    assert result.spp == 60


@pytest.mark.parametrize("spp", [2, 3, 17, 64, 256, 1000, 2048, 2049, 65536])
def test_passes_are_few_and_fit_the_sampler(spp: int) -> None:
    count, size = split_passes(spp)
    assert count == max(2, -(-spp // 1024))
    sampler = activate().load_dict({"type": "multijitter", "sample_count": size})
    assert sampler.sample_count() == size  # not rounded up to what it can stratify
    assert spp <= count * size
    assert count * (size - 1) < spp * (1 + 2 / np.sqrt(size))  # at most one row of the grid more than needed


def test_the_same_seed_gives_the_same_bits_where_threads_share_the_work() -> None:
    """Enough samples for many work units, with passes whose pixels straddle them: a film of float32 would differ."""
    loaded, rig = build_scene(ball_on_plane(), activate()), view(128, 97)
    first = radiance(loaded, rig, spp=100)
    for _ in range(3):
        again = radiance(loaded, rig, spp=100)
        assert np.array_equal(again.mean, first.mean)
        assert np.array_equal(again.variance, first.variance)


def test_sixty_five_thousand_samples_add_up_without_float32_bias() -> None:
    """A sky of 1/3 is exact in every sample; one float32 sum over 65536 of them is off by 1e-4."""
    mi = activate()
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1 / 3}}
    far = {"type": "sphere", "center": [0, 0, -1e3], "radius": 1.0}
    loaded = build_scene({"type": "scene", "sky": sky, "far": far}, mi)
    result = radiance(
        loaded, Rig(viewmats=np.eye(4)[None], Ks=intrinsics(4, 3, 40)[None], width=4, height=3), spp=65536
    )
    assert np.abs(result.mean * 3 - 1).max() < 3e-6


def test_a_firefly_is_counted_and_an_even_field_is_not() -> None:
    variance = np.random.default_rng(0).gamma(1.0, 1e-4, (20, 20))
    assert count_fireflies(variance, level=1.0) == 0
    variance[7, 7] = 1.0
    assert count_fireflies(variance, level=1.0) == 1


def test_target_error_is_reached_and_not_by_chance_only() -> None:
    loaded, rig = build_scene(ball_on_plane(), activate()), view(24, 18)
    result = radiance(loaded, rig, target_error=0.02)
    assert result.error <= 0.02
    reference = radiance(loaded, rig, spp=2048, seed=9)
    actual = np.sqrt(((result.mean - reference.mean) ** 2).mean()) / reference.mean.mean()
    assert actual < 0.02 * 1.5


def test_a_scalar_variant_reaches_a_target_by_even_passes() -> None:
    with using_variant("scalar") as mi:
        loaded, rig = build_scene(ball_on_plane(), mi), view(8, 6)
        integrator = mi.load_dict({"type": "path", "max_depth": 4, "rr_depth": 2})
        result = View(Method(mi, mi.variant(), loaded, integrator), rig, 0).render(None, 0.1)
    assert result.error <= 0.1
    assert result.spp >= 16


def small_job(out: Path, rig: Rig | None = None, **more: Any) -> Any:
    rig = rig or orbit_rig(3, 17, 13, 60, target=(0, 0, 0.8), radius=4.0)
    return render_set(ball_on_plane(), rig, out, **{"spp": 4, "plan": "rgb", **more})


def exr_arrays(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    return {p.stem: read_exr(p)[0] for p in sorted((folder / "gt").glob("*.exr"))}


def same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[k], b[k]) for k in a)


def test_a_set_is_complete_consistent_and_readable(tmp_path: Path) -> None:
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
def test_interrupted_reordered_and_repeated_renders_are_bit_identical(quality: dict, tmp_path: Path) -> None:
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


def test_an_interrupted_render_says_what_it_cost_in_all(tmp_path: Path) -> None:
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


def test_tracks_reproject_and_show_the_true_surface(tmp_path: Path) -> None:
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


def test_other_layouts_are_written_on_request_also_beside_a_finished_set(tmp_path: Path) -> None:
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


def test_another_process_renders_the_same_bits(tmp_path: Path) -> None:
    """Mitsuba's own optimizer orders merged shapes, and so lights, by memory address; we must not let it."""
    small_job(tmp_path / "a")
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        f"from pathlib import Path; from test_render import small_job; small_job(Path({str(tmp_path / 'b')!r}))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    first, second = exr_arrays(tmp_path / "a"), exr_arrays(tmp_path / "b")
    assert first.keys() == second.keys()
    assert all(same(first[k], second[k]) for k in first)
    digests = [json.loads((tmp_path / d / "set.json").read_text())["digest"] for d in "ab"]
    assert digests[0] == digests[1]


def test_a_finished_set_is_not_rendered_again_unless_something_changed(tmp_path: Path) -> None:
    small_job(tmp_path)
    stamp = (tmp_path / "set.json").stat().st_mtime_ns
    small_job(tmp_path)
    assert (tmp_path / "set.json").stat().st_mtime_ns == stamp
    first = exr_arrays(tmp_path)
    small_job(tmp_path, seed=1)
    second = exr_arrays(tmp_path)
    assert not np.array_equal(first["0000"]["R"], second["0000"]["R"])
    assert np.array_equal(first["0000"]["Z"], second["0000"]["Z"])


def test_fewer_views_remove_the_stale_ones(tmp_path: Path) -> None:
    small_job(tmp_path)
    rig = orbit_rig(2, 17, 13, 60, target=(0, 0, 0.8), radius=4.0)
    assert len(small_job(tmp_path, rig)) == 2
    assert len(list((tmp_path / "gt").iterdir())) == 2


@pytest.mark.parametrize(("width", "height"), [(1, 1), (2, 1), (7, 3)])
def test_tiny_images_render(width: int, height: int, tmp_path: Path) -> None:
    """Plainly, and with a plan and towards an error, which measure what they see in the image."""
    rig = orbit_rig(2, width, height, 20, target=(0, 0, 0.8), radius=4.0)
    plain = small_job(tmp_path / "plain", rig, spp=256)
    planned = small_job(tmp_path / "planned", rig, spp=None, target_error=0.05, plan="auto")
    for done in (plain, planned):
        assert done.radiance(1).shape == (height, width, 3)
    assert planned.radiance(1).mean() == pytest.approx(plain.radiance(1).mean(), rel=0.3)


def test_fireflies_are_said_in_the_set_and_on_the_way(tmp_path: Path) -> None:
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


def test_load_set_of_a_rendered_set_needs_no_mitsuba(tmp_path: Path) -> None:
    small_job(tmp_path)
    code = f"import sys, simscenes; s = simscenes.load_set({str(tmp_path)!r}); s.radiance(0); s.geometry(1); s.points(); print('mitsuba' in sys.modules)"  # noqa: E501
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
    assert load_set(tmp_path).meta["scene"] == "custom"
