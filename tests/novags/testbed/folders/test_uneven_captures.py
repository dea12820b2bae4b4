"""Captures whose views were not taken alike: what is written, who understands it, and who refuses it by name."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.methods import METHODS
from novags.methods.inputs import LacksInput
from novags.methods.memo import Memo
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.photographs.raw_files import read_exposure
from novags.testbed.folders.references import enhanced_truth
from novags.testbed.metrics.images import aligned_psnr
from novags.testbed.metrics.linear import exposure_gain, linear_psnr
from novags.testbed.stages.configs.capturing import AS_ONE, CaptureConfig
from novags.testbed.stages.configs.denoising import DenoisePicturesConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.reconstructing import prepare, reconstruct_views
from novags.testbed.stages.scores.noise import exposed_again
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from sensor_model import plan_effects
from sensor_model.frame.uneven import EVEN
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.png import read_png
from tests.novags.testbed.stages.test_capture_stage import photographs

QUIET = Console(quiet=True)
WAYS: dict[str, dict[str, Any]] = {
    "even": {}, "spread": {"exposure_spread": 1.0}, "cast": {"white_balance_spread": 80.0}, "burst": {"burst": 4},
    "bracket": {"bracket": 2.0},
    "all": {"exposure_spread": 0.5, "white_balance_spread": 80.0, "burst": 2, "bracket": 1.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One render, photographed in every way."""
    folder = tmp_path_factory.mktemp("uneven")
    stages.render(folder / "set", RenderConfig(scene="tabletop:11", n_views=9, width=48, height=48, spp=64,
                                               truth_samples=2), QUIET)  # fmt: skip
    for name, how in WAYS.items():
        stages.capture(folder / "set", folder / name, CaptureConfig(electrons=20.0, **how), QUIET)
    for name in ("even", "all"):
        how = {"sensor": "a7s2-iso6400", "electrons": 20.0, **WAYS[name]}
        stages.capture(folder / "set", folder / f"{name}-mosaic", CaptureConfig(**how), QUIET)
    return folder


def test_a_request_says_what_it_asks_for_alone(folder: Path) -> None:
    names = {field.name for field in fields(CaptureConfig)}
    beside = {"export", "dark_frames", "measured"}
    assert CaptureConfig().resolved().keys() == names - beside - AS_ONE.keys()  # as of versions without them
    for name, how in WAYS.items():
        asked = CaptureConfig(**how).resolved()
        assert {key: asked[key] for key in AS_ONE.keys() & asked.keys()} == how
        record = json.loads((folder / name / "capture.json").read_text())
        assert ("uneven" in record) == (name not in ("even", "burst"))
        assert record.get("burst", 1) == how.get("burst", 1)


@pytest.mark.parametrize("name", ["spread", "bracket", "all", "all-mosaic"])
def test_light_and_time_follow_the_factor_and_the_noise_free_exposure_does_not(name: str, folder: Path) -> None:
    even, uneven = open_capture(folder / ("even-mosaic" if "mosaic" in name else "even")), open_capture(folder / name)
    times = uneven.record.uneven.exposures
    black = uneven.levels[1]
    for i, factor in enumerate(times):
        mean = uneven.truth(i, "mean") - black
        np.testing.assert_allclose(mean, factor * (even.truth(i, "mean") - black), rtol=1e-3, atol=0.02 * factor)
        np.testing.assert_allclose(uneven.truth(i, "clean"), even.truth(i, "clean"), rtol=1e-5)
        np.testing.assert_allclose(uneven.clean_linear(i), even.clean_linear(i), atol=1e-6)
        stated, *_ = read_exposure(folder / name / "raw" / f"{uneven.names[i]}.dng")
        assert stated == pytest.approx(factor / 30, rel=1e-3)
        deviation = (uneven.raw(i) - uneven.truth(i, "mean")) / np.sqrt(uneven.truth(i, "variance"))
        assert abs(deviation.mean()) < 0.06  # rows share noise
        assert deviation.std() == pytest.approx(1, abs=0.06)
    assert len(set(times)) > 1


def test_white_balance_changes_pictures_and_no_raw_file(folder: Path) -> None:
    even, cast = open_capture(folder / "even"), open_capture(folder / "cast")
    for i in range(9):
        np.testing.assert_array_equal(cast.raw(i), even.raw(i))
        seen, other = (read_png(of.path / "images" / f"{of.names[i]}.png") for of in (cast, even))
        assert not np.array_equal(seen, other)
        np.testing.assert_allclose(cast.linear16(i), even.linear16(i), atol=2 / 61439)


def test_fixed_patterns_that_one_frame_hides_are_planned_for_a_burst() -> None:
    light = np.array([1.0, 5.0, 10.0, 20.0, 40.0])
    for burst, on in ((1, False), (256, True)):
        config = CaptureConfig(sensor="imx900-hcg", burst=burst)
        plan = plan_effects(config.camera, config.exposure, light, config.limits(1000))
        assert plan.is_on("prnu") == on


def test_a_burst_is_the_mean_of_frames_of_which_the_first_is_the_view_alone(folder: Path) -> None:
    even, burst = open_capture(folder / "even"), open_capture(folder / "burst")
    np.testing.assert_array_equal(even.truth(1, "mean"), burst.truth(1, "mean"))
    np.testing.assert_allclose(burst.truth(1, "variance"), even.truth(1, "variance") / 4 + 1 / 12, rtol=1e-5)
    parts = [(of.raw(1) - of.truth(1, "mean")).ravel() for of in (even, burst)]
    assert np.corrcoef(parts)[0, 1] == pytest.approx(0.5, abs=0.06)  # of four independent frames one is common


@pytest.mark.parametrize("name", [*WAYS, "all-mosaic"])
def test_the_noise_of_each_evened_view_is_the_one_that_methods_are_told(name: str, folder: Path) -> None:
    capture = open_capture(folder / name)
    for i in range(0, 9, 2):
        noise = capture.noise_at(i)
        assert noise is not None
        clean = capture.clean_linear(i, demosaiced=True)
        error = (capture.linear16(i) - clean) / noise.linear16.curve.variance(clean) ** 0.5
        if capture.sensor is not None and capture.sensor.cfa:
            rows, columns = np.indices(clean.shape[:2]) % 2
            red = (rows == 0) & (columns == 0)  # behind RGGB: interpolated values have less noise
            error = error[red, 0]
        assert error.std() == pytest.approx(1, abs=0.1)
        assert abs(error.mean()) < 0.15


@pytest.mark.parametrize("pictures", ["8bit", "16bit"])
def test_an_exposure_that_is_taken_again_is_evened_as_the_first(pictures: str, folder: Path) -> None:
    capture = open_capture(folder / "all")
    source = capture.source(QUIET)
    for i in (0, 3):
        again = exposed_again(capture, source, i, 0, pictures)
        np.testing.assert_allclose(again, capture.dark(i, pictures), atol=1e-6)  # type: ignore[arg-type]


def blind(capture: Capture) -> Capture:
    """The same files, of which nobody is told that views differ."""
    return replace(capture, record=replace(capture.record, uneven=EVEN), memo=Memo())


def shown(method: str, capture: Capture, told: Capture, out: Path) -> float:
    """Mean score in dB of the held-out views of a fit of `capture`, against the references of `told`."""
    preset = adapted(EXPERIMENTS["demo"], methods=(method,), iterations=300, points=1500, device="cpu")
    config, indices = preset.reconstruct(method), told.cameras.test_indices
    prepared = prepare(capture, capture.source(QUIET), config, QUIET)
    body = reconstruct_views(capture, prepared, out, config, QUIET)
    if body["space"] == "enhanced":
        made = {i: read_png(out / "renders" / f"{told.names[i]}.png") for i in indices}
        return float(np.mean([aligned_psnr(made[i], enhanced_truth(told, i, body["enhancement"])) for i in indices]))
    light = [read_exr(out / "exr" / f"{told.names[i]}.exr")[0] for i in indices]
    pairs = [(np.stack([each[c] for c in "RGB"], -1), told.clean_linear(i))
             for each, i in zip(light, indices, strict=True)]  # fmt: skip
    gain, white = exposure_gain(pairs), float(np.quantile(pairs[0][1], 0.99))
    return float(np.mean([linear_psnr(*pair, gain, white) for pair in pairs]))


@pytest.mark.parametrize("way", ["spread", "bracket"])
def test_a_fit_in_linear_light_that_knows_the_exposures_loses_little_and_one_that_does_not_a_decibel(
    way: str, folder: Path, tmp_path: Path
) -> None:
    even, uneven = open_capture(folder / "even"), open_capture(folder / way)
    alike, known = (shown("raw-gs", capture, capture, tmp_path / capture.path.name) for capture in (even, uneven))
    unknown = shown("raw-gs", blind(uneven), uneven, tmp_path / "blind")
    print(f"raw-gs, {way}: {alike:.2f} dB, told {known:.2f}, not told {unknown:.2f}")  # for docs/captures.md
    assert known > alike - 0.8  # by which views happen to be shorter
    assert unknown < known - 1.0


def test_a_fit_of_enhanced_pictures_loses_little_even_if_it_is_not_told_the_exposures(
    folder: Path, tmp_path: Path
) -> None:
    captures = [open_capture(folder / name) for name in ("even", "spread", "cast")]
    alike, *others = (shown("naive", capture, capture, tmp_path / capture.path.name) for capture in captures)
    # the enhancement brings every view to one brightness by itself
    unknown = shown("naive", blind(captures[1]), captures[1], tmp_path / "blind")
    print(f"naive: {alike:.2f} dB, told {others[0]:.2f}, not told {unknown:.2f}")
    assert min(*others, unknown) > alike - 0.8  # likewise


def test_methods_with_one_noise_for_all_views_refuse_several_exposures_by_name(folder: Path, tmp_path: Path) -> None:
    for name, said in (("nova-plus", "likelihood knows one noise"), ("denoise-gs", "denoising knows one noise")):
        preset = adapted(EXPERIMENTS["demo"], methods=(name,), iterations=20, points=500, device="cpu")
        config = preset.reconstruct(name)
        for capture in (open_capture(folder / "spread"), open_capture(folder / "bracket")):
            problem = prepare(capture, capture.source(QUIET), config, QUIET).problem
            with pytest.raises(LacksInput, match=f"{said}.* exposed .* to .* times .* take a method"):
                METHODS[config.variant.method].train(problem, config.config)
    with pytest.raises(LacksInput, match="denoising knows one noise"):
        stages.denoise(folder / "spread", tmp_path / "out", DenoisePicturesConfig(), QUIET)


def test_an_uneven_capture_is_neither_a_set_nor_photographs(folder: Path, tmp_path: Path) -> None:
    said = "the views of .* differ in exposure or white balance"
    with pytest.raises(ValueError, match=said):
        stages.capture(folder / "cast", tmp_path / "cap", CaptureConfig(), QUIET)
    with pytest.raises(ValueError, match=said):
        stages.import_photographs(folder / "spread", tmp_path / "in", ImportConfig(), QUIET)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"exposure_spread": -1.0}, "^exposure_spread must be >= 0 stops, got -1"),
        ({"exposure_spread": float("nan")}, "^exposure_spread must be >= 0 stops, got nan"),
        ({"white_balance_spread": 301.0}, "^white_balance_spread must be <= 300 mired, got 301"),
        ({"bracket": -2.0}, "^bracket must be >= 0 stops, got -2"),
        ({"burst": 0}, "^burst must be >= 1 frames, got 0"),
        ({"bracket": 2.0, "time": 0.0}, "^time must leave the exposures of all views in"),
        (
            {"exposure_spread": 1.0, "export": ("llff",)},
            "^export must be empty where exposure or white balance differs",
        ),
    ],
)
def test_what_cannot_be_is_refused(how: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        CaptureConfig(**how)


def test_one_view_cannot_be_bracketed(tmp_path: Path) -> None:
    views = photographs(tmp_path / "set", n=1)
    with pytest.raises(ValueError, match="bracket interleaves two exposures: it needs 2 views or more, and .* has 1"):
        stages.capture(views, tmp_path / "cap", CaptureConfig(bracket=1.0), QUIET)


@pytest.mark.parametrize(
    "change", [{"exposures": [1.0]}, {"exposures": [0.0] * 9}, {"balances": [[1.0, 1.0, 1e9]] * 9}]
)
def test_a_record_with_impossible_factors_is_refused(change: dict[str, Any], folder: Path, tmp_path: Path) -> None:
    from novags.testbed.folders.capture_record import read_capture_record

    record = json.loads((folder / "all" / "capture.json").read_text())
    (tmp_path / "capture.json").write_text(json.dumps(record | {"uneven": record["uneven"] | change}))
    with pytest.raises(ValueError, match="uneven must .*capture again"):
        read_capture_record(tmp_path / "capture.json")


def test_a_report_titles_how_views_were_taken(folder: Path) -> None:
    found = open_capture(folder / "all").record.variety
    assert found.startswith("bursts of 2, exposed 0.")
    assert found.endswith("times as long, white balance by view")
    assert open_capture(folder / "even").record.variety == ""
