"""Claims about captures: any camera, any images, one view in memory at a time."""

import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pycolmap
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.set import Source, open_source
from novags.testbed.stages import capturing, planning
from novags.testbed.stages.capturing import expose_view
from novags.testbed.stages.configs.capturing import CaptureConfig, OwnNoiseConfig
from novags.testbed.stages.planning import PILOT, light_plan, sensor_plan
from novags.testbed.stages.rendering import render_views
from sensor_model import PRESETS, Exposure, plan_effects, read_sensor, srgb_to_linear, write_sensor
from simscenes import SparsePoints, load_set, orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.exr import read_exr, write_exr

QUIET = Console(quiet=True)
CAMERA = "gain = 1.5\neta = 0.6\nmu_e_sat = 5000\nblack_level = 64.5\nbits = 12\nsigma_d = 2.0\n"


def photographs(folder: Path, n: int = 3, size: tuple[int, int] = (20, 16)) -> Path:
    """A folder of posed 8-bit photographs."""
    names = [f"{i:04d}" for i in range(n)]
    write_cameras(folder, names, orbit_rig(n, *size, 50.0, radius=3.0))
    (folder / "images").mkdir()
    rng = np.random.default_rng(0)
    for name in names:
        cv2.imwrite(str(folder / "images" / f"{name}.png"), rng.integers(20, 250, (size[1], size[0], 3), np.uint8))
    return folder


def test_a_camera_file_takes_the_pictures_and_its_content_decides_what_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    views, file, out = photographs(tmp_path / "set"), tmp_path / "mine.toml", tmp_path / "cap"
    file.write_text(CAMERA)

    def take() -> tuple[str, int]:
        record = stages.capture(views, out, CaptureConfig(sensor=str(file)), QUIET, overwrite=True)
        return record["stage"]["key"], (out / "images" / "0000.png").stat().st_mtime_ns

    first = take()
    opened = open_capture(out)
    assert opened.sensor == read_sensor(file)
    assert opened.record.sensor_name == "mine"
    file.write_text("# a comment changes nothing\n" + CAMERA)
    assert take() == first
    file.write_text(CAMERA.replace("sigma_d = 2.0", "sigma_d = 9.0"))
    key, written = take()
    assert key != first[0]
    assert written > first[1]
    assert open_capture(out).sensor.sigma_d == 9.0
    last = take()
    monkeypatch.chdir(tmp_path)
    file = Path("mine.toml")
    assert take() == last


def test_the_plan_is_made_for_the_camera_in_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(CAMERA + "sigma_row = 5.0\n")
    config = CaptureConfig(sensor=str(tmp_path / "mine.toml"), electrons=50.0)
    plan, _ = sensor_plan(replace(PILOT, scene=str(photographs(tmp_path / "set"))), config, 1, QUIET)
    assert plan is not None
    assert plan.is_on("row_noise")


def test_the_sketch_of_a_scene_follows_the_plan_that_is_shown_and_says_no_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pilot = replace(PILOT, scene="cornell", n_views=3, spp=2)
    shown = light_plan(pilot, 0.02, QUIET)
    assert shown is not None
    followed = list[object]()
    monkeypatch.setattr(planning, "render_views", lambda out, config, rig, plan, *rest, **options: (
        followed.append(plan), render_views(out, config, rig, plan, *rest, **options)))  # fmt: skip
    sensor_plan(pilot, CaptureConfig(sensor="a7s2-iso6400", electrons=20.0), 48 * 48, Console(), shown)
    assert followed == [shown]
    said = capsys.readouterr().err
    assert "sketch: 3/3" in said
    assert "error" not in said


def test_defects_are_planned_for_the_pixels_of_the_capture_not_of_the_pilot(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        CAMERA + "dark_current = 10.0\n[defects]\nhot_fraction = 1e-6\nhot_factor = 1e5\n"
    )
    config = CaptureConfig(sensor=str(tmp_path / "mine.toml"))
    few, many = (sensor_plan(replace(PILOT, scene="cornell"), config, side * side, QUIET)[0] for side in (48, 160))
    assert few is not None
    assert many is not None
    assert not few.is_on("hot_pixels")
    assert many.is_on("hot_pixels")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("gain = ", "mine.toml"),
        (CAMERA + "sigma_read = 1.0", "got 'sigma_read'"),
        (CAMERA.replace("eta = 0.6", "eta = 60"), r"eta must be in \(0, 1\]"),
    ],
)
def test_a_wrong_camera_file_is_one_line_and_exit_code_2(
    content: str | None,
    message: str,
    call: Callable[..., int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    if content is not None:
        (tmp_path / "mine.toml").write_text(content)
    monkeypatch.chdir(tmp_path)
    for command in (["capture", "set", "--out", "cap"], ["plan", "set", "--electrons", "5"], ["run", "--out", "x"]):
        assert call(*command, "--sensor", "mine.toml") == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1
        assert re.match(r"novags: error: mine\.toml(: | is not a readable TOML file)", lines[0])
        assert re.search(message, lines[0])
    assert not (tmp_path / "cap").exists()


@pytest.mark.parametrize("name", ["prime-95b", "ideal", "imx385-iso1600"])
def test_a_capture_remembers_its_camera_whole(name: str, tmp_path: Path) -> None:
    """Rationale: JSON has no tuples, no infinities and no nested objects of ours."""
    stages.capture(photographs(tmp_path / "set"), tmp_path / "cap", CaptureConfig(sensor=name), QUIET)
    assert open_capture(tmp_path / "cap").sensor == PRESETS[name]
    assert json.loads((tmp_path / "cap" / "capture.json").read_text())["sensor_name"] == name


def test_a_preset_written_to_a_file_takes_the_same_pictures(tmp_path: Path) -> None:
    views = photographs(tmp_path / "set")
    write_sensor(tmp_path / "copy.toml", PRESETS["imx900-hcg"])
    for name in ("imx900-hcg", str(tmp_path / "copy.toml")):
        stages.capture(views, tmp_path / Path(name).stem, CaptureConfig(sensor=name), QUIET)
    first, second = ((tmp_path / stem / "raw" / "0001.dng").read_bytes() for stem in ("imx900-hcg", "copy"))
    assert first == second


def test_a_set_that_turned_black_costs_no_finished_capture(tmp_path: Path) -> None:
    views, out = photographs(tmp_path / "set"), tmp_path / "cap"
    stages.capture(views, out, CaptureConfig(), QUIET)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    for image in (views / "images").iterdir():
        cv2.imwrite(str(image), np.zeros((16, 20, 3), np.uint8))
    said = "the green channel of the set .*set is black, .* check that its pictures are right"
    with pytest.raises(ValueError, match=said):
        stages.capture(views, out, CaptureConfig(), QUIET, overwrite=True)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_jpeg_touches_the_8_bit_pictures_only(tmp_path: Path) -> None:
    views = photographs(tmp_path / "set")
    for quality in (None, 40):
        config = CaptureConfig(sensor="ideal-3chip", electrons=500.0, jpeg_quality=quality)
        stages.capture(views, tmp_path / str(quality), config, QUIET)
    plain, jpeg = (open_capture(tmp_path / name) for name in ("None", "40"))
    assert 0.001 < np.abs(plain.srgb8(0) - jpeg.srgb8(0)).mean() < 0.2
    np.testing.assert_array_equal(plain.dark(0, "16bit"), jpeg.dark(0, "16bit"))
    with pytest.raises(ValueError, match="jpeg_quality must be"):
        CaptureConfig(jpeg_quality=0)


def test_a_set_seen_through_a_cameras_own_filters_is_captured_with_them(tmp_path: Path) -> None:
    """White collects what the filters let through; a colour, seen by them, develops to the sRGB it was."""
    matrix = np.array([[0.5, 0.2, 0.1], [0.1, 0.8, 0.1], [0.0, 0.1, 0.5]])
    white, color = matrix.sum(1), np.array([0.2, 0.35, 0.5])
    views, names = tmp_path / "set", [f"{i:04d}" for i in range(3)]
    write_cameras(views, names, orbit_rig(3, 32, 24, 50.0, radius=3.0))
    for part in ("images", "gt"):
        (views / part).mkdir()
    for name in names:
        cv2.imwrite(str(views / "images" / f"{name}.png"), np.full((24, 32, 3), 200, np.uint8))
        light = np.broadcast_to(matrix @ color, (24, 32, 3)).astype(np.float32).copy()
        light[:12] = 0.4 * white
        write_exr(views / "gt" / f"{name}.exr", {c: light[..., k].copy() for k, c in enumerate("RGB")})
    meta = {"kind": "rendered", "camera_matrix": matrix.tolist(), "exposure_scale": 1.0}
    (views / "set.json").write_text(json.dumps(meta))
    stages.capture(views, tmp_path / "cap", CaptureConfig(sensor="ideal-3chip", electrons=1500), QUIET)
    opened = open_capture(tmp_path / "cap")
    assert np.allclose(opened.sensor.rgb_response, white / white[1])
    truth, _ = read_exr(tmp_path / "cap" / "truth" / "0000.exr")
    signal = np.array([truth[f"mean.{c}"][:12].mean() for c in "RGB"])
    assert np.allclose(signal / signal[1], white / white[1], rtol=1e-3)
    clean = srgb_to_linear(opened.clean(0)).mean(1)
    assert np.allclose(clean[5] / clean[5, 1], 1, rtol=1e-3)
    assert np.allclose(clean[20] / clean[5, 1], color / 0.4, rtol=5e-3)
    taken = srgb_to_linear(opened.srgb8(1)).mean(1)
    assert np.allclose(taken[20], clean[20], rtol=0.05)


def test_images_too_small_for_raw_files_are_said_before_the_work_and_where_they_are_needed(tmp_path: Path) -> None:
    told = io.StringIO()
    stages.capture(photographs(tmp_path / "set"), tmp_path / "cap", CaptureConfig(), Console(stream=told))
    notes = told.getvalue()
    assert notes.index("20 x 16 px make raw files that LibRaw refuses: it takes 22 px") < notes.index("capture: light")
    with pytest.raises(ValueError, match=r"0000.dng is not a readable raw file .* under 22 px"):
        open_capture(tmp_path / "cap").raw(0)
    told = io.StringIO()
    large = photographs(tmp_path / "large", size=(24, 22))
    stages.capture(large, tmp_path / "larger", CaptureConfig(), Console(stream=told))
    assert "LibRaw" not in told.getvalue()
    assert open_capture(tmp_path / "larger").raw(0).shape[:2] == (22, 24)


def test_a_signal_that_is_mostly_white_is_said(tmp_path: Path) -> None:
    views = photographs(tmp_path / "set")
    capacity = PRESETS[CaptureConfig().sensor].capacity_e
    for share, said in ((0.3, False), (4.0, True)):  # of what the camera holds, in the mean of green
        told = io.StringIO()
        stages.capture(views, tmp_path / f"{share}", CaptureConfig(electrons=share * capacity), Console(stream=told))
        assert ("more than half of the signal is white" in told.getvalue()) == said


@pytest.mark.parametrize("row", [[0.0, 0.0, 0.0], [1e300, 0, 0], [1e-7, 0, 0]])
def test_colour_filters_that_no_camera_has_are_refused(row: list[float], tmp_path: Path) -> None:
    views = SimpleNamespace(meta={"camera_matrix": [row, [0, 1, 0], [0, 0, 1]]}, path=tmp_path)
    with pytest.raises(ValueError, match="camera_matrix of .* within a factor of 1000 of green's"):
        _ = Source(views, None, QUIET).response


@pytest.mark.parametrize("exposure", [0.0, -1.0, 1e31, 1e308, float("nan")])
def test_an_exposure_of_the_set_that_would_make_pictures_black_or_nan_is_refused(
    exposure: float, tmp_path: Path
) -> None:
    size = SimpleNamespace(width=4, height=4), SimpleNamespace(width=2, height=2)
    views = SimpleNamespace(
        meta={"exposure_scale": exposure}, path=tmp_path, rig=size[0], kind="rendered", is_deep=lambda i: False,
        files=[tmp_path / "0.png"], radiance=lambda i: np.ones((4, 4, 3), np.float32),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"exposure_scale of .* must be > 0 and at most 1e\+30, got"):
        Source(views, size[1], QUIET).lit(0)


@pytest.mark.parametrize("max_size", [None, 32])
def test_a_capture_has_the_tracks_and_errors_of_its_set(tmp_path: Path, max_size: int | None) -> None:
    """A point that a view does not see (hidden, or not matched) stays unseen in the capture's COLMAP model."""
    rng, rig, names = np.random.default_rng(0), orbit_rig(5, 64, 48, 50.0, radius=3.0), [f"{i:04d}" for i in range(5)]
    sees = rng.random((5, 30)) < 0.5
    sees[0] = True
    xyz = rng.uniform(-0.4, 0.4, (30, 3))
    exact = SparsePoints.seen(rig, xyz, np.zeros((30, 3)), sees, exact=True)
    noisy = exact.observed(rig, exact.view, exact.point, exact.pixel + rng.normal(0, 0.5, exact.pixel.shape))
    write_cameras(tmp_path / "set", names, rig, points=noisy)
    (tmp_path / "set/images").mkdir()
    for name in names:
        cv2.imwrite(str(tmp_path / "set/images" / f"{name}.png"), np.full((48, 64, 3), 90, np.uint8))
    stages.capture(tmp_path / "set", tmp_path / "cap", CaptureConfig(max_size=max_size), QUIET)
    points = load_set(tmp_path / "cap").points()
    model = pycolmap.Reconstruction(str(tmp_path / "cap/sparse/0"))
    assert points is not None
    seen = np.zeros_like(sees)
    for image in model.images.values():
        seen[int(Path(image.name).stem), [p.point3D_id - 1 for p in image.points2D]] = True
    assert np.array_equal(seen, sees)
    mean = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    assert mean == pytest.approx(model.compute_mean_reprojection_error(), rel=1e-9)
    assert mean == pytest.approx(noisy.error.mean() * (1.0 if max_size is None else 0.5), rel=1e-9)


def test_a_layout_that_cannot_hold_the_cameras_is_refused_before_anything_is_photographed(tmp_path: Path) -> None:
    views, out = photographs(tmp_path / "set", 3, (24, 24)), tmp_path / "cap"
    rig = load_set(views).rig
    write_cameras(views, ["0000", "0001", "0002"], replace(rig, Ks=rig.Ks * [[[1.0], [1.003], [1.0]]]))
    with pytest.raises(ValueError, match="one focal length per view"):
        stages.capture(views, out, CaptureConfig(export=("llff",)), QUIET)
    assert not out.exists() or not list(out.glob("raw/*"))


def test_further_layouts_of_a_capture_show_the_dark_pictures_with_the_sets_own_depth(tmp_path: Path) -> None:
    views, out = photographs(tmp_path / "set", 3, (24, 24)), tmp_path / "cap"
    rng = np.random.default_rng(1)
    rig = load_set(views).rig
    xyz = rng.normal(0, 0.3, (40, 3))
    points = SparsePoints.seen(rig, xyz, rng.integers(0, 256, (40, 3), np.uint8), np.ones((3, 40), bool), exact=True)
    write_cameras(views, ["0000", "0001", "0002"], rig, points=points)
    plain = stages.capture(views, out, CaptureConfig(), QUIET)
    again = stages.capture(views, out, CaptureConfig(export=("blender", "llff")), QUIET)
    assert again == plain  # nothing is photographed again for them
    dark = load_set(out)
    assert dark.scene == "set"
    for layout, file in (("blender", "train/0001.png"), ("llff", "images/0001.png")):
        picture = cv2.imread(str(out / layout / file), cv2.IMREAD_COLOR)[..., ::-1]
        assert np.array_equal(picture, dark.image(1))
        assert json.loads((out / layout / "nb-info.json").read_text())["scene"] == "set"
    assert json.loads((out / "nb-info.json").read_text())["scene"] == "set"
    with pytest.raises(ValueError, match="export must be among blender, llff; got colmap"):
        CaptureConfig(export=("colmap",))


def with_points(views: Path, xyz: np.ndarray) -> None:
    """Give photographs a model whose points all views see that have them in their picture."""
    rig = load_set(views).rig
    names = [f"{i:04d}" for i in range(len(rig))]
    inside = (np.abs(rig.project(xyz)[0] - (rig.width / 2, rig.height / 2)) < rig.width / 2).all(-1)
    points = SparsePoints.seen(rig, xyz, np.zeros((len(xyz), 3), np.uint8), inside, exact=True)
    write_cameras(views, names, rig, points=points)


def test_photographs_of_unknown_depth_are_refused_for_llff_before_anything_is_photographed(tmp_path: Path) -> None:
    views, out = photographs(tmp_path / "set", 3, (24, 24)), tmp_path / "cap"
    told = io.StringIO()
    with pytest.raises(ValueError, match="near and far of the views of .*set are not known: .* novags poses makes one"):
        stages.capture(views, out, CaptureConfig(export=("llff",)), Console(stream=told))
    assert "capture:" not in told.getvalue()
    assert not out.exists()
    stages.capture(views, out, CaptureConfig(export=("blender",)), QUIET)  # which states no near and far
    assert (out / "blender" / "transforms_train.json").is_file()


@pytest.mark.parametrize("max_size", [None, 12])
def test_a_view_that_sees_no_point_is_named_before_the_work_and_llff_bounds_are_those_of_the_points(
    max_size: int | None, tmp_path: Path
) -> None:
    views = photographs(tmp_path / "set", 3, (24, 24))
    eye, ahead = (load_set(views).rig.positions[1], -load_set(views).rig.positions[1] / 3)
    with_points(views, eye + 0.2 * ahead + np.random.default_rng(2).normal(0, 0.01, (20, 3)))  # before view 1 alone
    config = CaptureConfig(export=("llff",), max_size=max_size)
    with pytest.raises(ValueError, match="view 0000 of .* sees no surface and no point: .* Leave that view out"):
        stages.capture(views, tmp_path / "cap", config, QUIET)
    assert not (tmp_path / "cap").exists()
    with_points(views, np.random.default_rng(2).normal(0, 0.1, (20, 3)))
    stages.capture(views, tmp_path / "cap", config, QUIET)
    near, far = np.load(tmp_path / "cap" / "llff" / "poses_bounds.npy")[:, 15:].T
    assert ((near > 2.5) & (near < 3) & (far > 3) & (far < 3.5)).all()


def test_a_scene_without_light_is_named_by_its_plan_and_not_the_folder_of_the_pilot(
    tmp_path: Path, ball_xml: str
) -> None:
    away = '<emitter type="spot"><transform name="to_world"><lookat origin="0,0,4" target="0,0,9" up="0,1,0"/>'
    file = tmp_path / "dark.xml"
    file.write_text(ball_xml.replace('<emitter type="constant"/>', f"{away}</transform></emitter>"))
    config = CaptureConfig(sensor="ideal")
    said = f"^the green channel of the scene {file} is black, .* add an emitter .* check that one"
    with pytest.raises(ValueError, match=said):
        sensor_plan(replace(PILOT, scene=str(file)), config, 1, QUIET)


def test_the_range_of_the_signal_is_told_from_the_darkest_to_the_brightest(monkeypatch: pytest.MonkeyPatch) -> None:
    light = SimpleNamespace(signal_e=np.array([1.0, 2.0, 3.0, 5.0, 9.0]), plan=None)
    monkeypatch.setattr(planning, "meter", lambda *_: light)
    nothing: Any = None
    assert planning._plan(nothing, nothing, None, QUIET) == (None, {"darkest": 1.0, "median": 3.0, "brightest": 9.0})


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_another_seed_has_other_noise_and_exposures_and_the_same_seed_the_same(spread: float, tmp_path: Path) -> None:
    views, codes, exposures = photographs(tmp_path / "set", size=(32, 24)), list[bytes](), list[object]()
    how: Any = {"electrons": 20.0, "exposure_spread": spread}
    configs = [CaptureConfig(**how, seed=seed) for seed in (3, 3, 4)]
    for k, config in enumerate([*configs, OwnNoiseConfig(**how, seed=4, drawn=3)]):
        stages.capture(views, tmp_path / f"{k}", config, QUIET)
        light: Any = (capture := open_capture(tmp_path / f"{k}")).record.simulated
        assert light.seed == config.seed
        told = list(light.signal_quantiles_e.values())
        assert told == sorted(told)
        assert told[0] < told[len(told) // 2] < told[-1]
        codes.append(np.stack([capture.raw(i) for i in range(3)]).tobytes())
        exposures.append(capture.record.uneven.exposures)
    assert codes[0] == codes[1] == codes[3] != codes[2]
    assert [each == exposures[0] for each in exposures] == [True, True, spread == 0, True]


def test_the_plan_is_made_for_the_longest_exposure_of_all_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned = Mock(wraps=plan_effects)
    monkeypatch.setattr(capturing, "plan_effects", planned)
    config = CaptureConfig(electrons=20.0, bracket=2.0)
    capturing.meter(open_source(photographs(tmp_path), QUIET), config, QUIET)
    assert planned.call_args.args[1].time == pytest.approx(4 * config.time)


def test_an_exposure_has_the_noise_of_its_seed_and_of_its_view() -> None:
    light, sensor = np.full((24, 32, 3), 0.5), PRESETS["ideal-3chip"]

    def taken(seed: int, view: int) -> bytes:
        frame = expose_view(light, sensor, Exposure(time=1.0), electrons=9.0, mean_green=0.5, seed=seed, view=view)
        return bytes(frame.dn.tobytes())

    assert taken(3, 1) == taken(3, 1)
    assert len({taken(3, 1), taken(0, 1), taken(3, 2)}) == 3
