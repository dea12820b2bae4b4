"""Claims about single commands: options that belong together are taken together, or refused in one line."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

Call = Callable[..., int]


def test_one_method_is_reconstructed_and_it_is_the_one_that_is_named(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Rationale: the first variant of a file was taken whatever --method said."""
    from novags.testbed import stages

    seen = []
    monkeypatch.setattr(stages, "reconstruct", lambda _, __, config, *___, **____: seen.append(config.variant.name))
    (tmp_path / "two.toml").write_text('[variant.x]\nmethod = "naive"\n[variant.y]\nmethod = "naive"\n')
    two, one = ("--variant", str(tmp_path / "two.toml")), ("--variant", "l1=naive:fit.dssim_weight=0")
    words = ("reconstruct", str(tmp_path), "--out", str(tmp_path / "run"))
    for named in ((), ("--method", "naive"), one, (*one, "--method", "l1"), (*two, "--method", "y")):
        assert call(*words, *named) == 0
    assert seen == ["nova-fast", "naive", "l1", "l1", "y"]
    for named, why in ((two, "defines x, y, more than one"), ((*one, "--method", "naive"), "but --method is naive")):
        capsys.readouterr()
        assert call(*words, *named) == 2
        assert why in capsys.readouterr().err
    assert len(seen) == 5


@pytest.mark.parametrize(
    ("words", "stage"),
    [
        (("render", "cornell"), "render"), (("poses", "."), "poses"), (("capture", "."), "capture"),
        (("denoise", "."), "denoise"), (("reconstruct", "."), "reconstruct"),
    ],
)  # fmt: skip
def test_the_seed_of_a_command_reaches_its_stage(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: tuple[str, ...], stage: str
) -> None:
    from novags.testbed import stages

    seen = []

    def asked(*given: Any, **_: Any) -> None:
        seen.extend(one.seed for one in given if hasattr(one, "seed"))
        raise ValueError("seen enough")

    monkeypatch.setattr(stages, stage, asked)
    for seed in (7, 8):
        assert call(*words, "--seed", str(seed), "--out", str(tmp_path / "out")) == 2
    assert seen == [7, 8]


def test_the_seed_of_an_experiment_reaches_its_noise_and_its_training(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.testbed.study import place

    seen: list[Any] = []
    monkeypatch.setattr(place, "run", lambda preset, *_, **__: seen.append(preset) or tmp_path)
    assert call("run", "--methods", "naive", "--seed", "7", "--out", str(tmp_path)) == 0
    assert (seen[0].capture.seed, seen[0].reconstruct("naive").seed) == (7, 7)


@pytest.mark.parametrize(("dark", "advised"), [(True, "novags import "), (False, "novags capture ")])
def test_dark_photographs_with_cameras_are_to_be_imported_and_not_made_dark_again(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, dark: bool,
    advised: str,
) -> None:  # fmt: skip
    from novags.testbed import stages

    monkeypatch.setattr(stages, "poses", lambda *_, **__: {"dark": dark})
    assert call("poses", str(tmp_path), "--out", str(tmp_path / "set")) == 0
    assert f"next: {advised}" in capsys.readouterr().err


def test_photographs_are_imported_with_the_black_and_the_white_that_are_said(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.testbed import stages

    seen: list[Any] = []
    monkeypatch.setattr(stages, "import_photographs", lambda _, __, config, *___, **____: seen.append(config))
    assert call("import", str(tmp_path), "--black", "64", "--white", "1023", "--out", str(tmp_path / "cap")) == 0
    assert (seen[0].black, seen[0].white) == (64, 1023)


def test_scores_are_said_of_every_place_that_runs_lie_in(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.commands import results
    from novags.testbed.report import place, verdict
    from novags.testbed.study import place as study

    places = [SimpleNamespace(title=f"at {light}", metrics={"methods": {"naive": {"mean": {}}}}) for light in "ab"]
    monkeypatch.setattr(study, "together", lambda runs: {})
    monkeypatch.setattr(place, "places_in", lambda *_: places)
    monkeypatch.setattr(verdict, "limits", lambda _: None)
    monkeypatch.setattr(results, "_in_words", lambda mean, place, name: place.title)
    assert call("score", str(tmp_path), str(tmp_path / "other")) == 0
    assert capsys.readouterr().out.split("\n")[:-1] == ["at a:", "naive: at a", "at b:", "naive: at b"]


@pytest.mark.parametrize("differing", ["", "first", "second", "third"])
def test_runs_that_are_made_again_are_drawn_by_the_seed_and_one_part_that_differs_is_enough(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, differing: str
) -> None:
    from novags.commands.results import DIFFERS
    from novags.testbed.stages.explaining import verifying

    asked = list[Any]()

    def drawn(*how: Any) -> dict[str, Any]:
        asked.append(how)
        return {}

    made = [SimpleNamespace(line=partial(str, name), same=name != differing) for name in ("first", "second", "third")]
    monkeypatch.setattr(verifying, "chosen_runs", drawn)
    monkeypatch.setattr(verifying, "verify", lambda *_: made)
    words = ("verify", str(tmp_path), "--out", str(tmp_path / "out"), "--count", "2", "--seed")
    for seed in (7, 8):
        assert call(*words, str(seed)) == (DIFFERS if differing else 0)
        assert capsys.readouterr().out.split() == ["first", "second", "third"]
    assert asked == [((tmp_path,), 2, seed) for seed in (7, 8)]
    assert call(*words, "-1") == 2
    assert "seed must be >= 0" in capsys.readouterr().err


def test_a_camera_at_several_isos_has_a_file_of_maps_for_each(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.testbed.importing.calibration import camera
    from sensor_model import PRESETS, Measured
    from sensor_model.files.camera_file import read_camera, read_maps

    def setting(iso: int) -> camera.MeasuredSetting:
        maps = Measured(offset=np.full((8, 8), iso, np.float32), response=np.ones((8, 8), np.float32))
        return camera.MeasuredSetting(sensor=PRESETS[f"a7s2-iso{iso}"], found=None, assumed={}, test=(), maps=maps,
                                      profile=None)  # fmt: skip

    made = camera.OwnCamera(settings={iso: setting(iso) for iso in (100, 1600, 6400)}, fits=())
    monkeypatch.setattr(camera, "characterise_folder", lambda *_, **__: made)
    assert call("characterise", str(tmp_path), "--maps", "--out", str(tmp_path / "mine.toml")) == 0
    for iso in made.settings:
        found = read_camera(f"{tmp_path / 'mine.toml'}@{iso}")
        assert found.sensor == PRESETS[f"a7s2-iso{iso}"]
        assert found.maps == tmp_path / f"mine-iso{iso}.npz"
        assert found.maps is not None
        assert (read_maps(found.maps, (8, 8)).offset == iso).all()


def test_an_effect_is_written_with_its_camera_or_not_at_all(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call("new", "effect", "glow") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["glow.py", "glow.toml"]
    for there, missing in (("glow.toml", "glow.py"), ("glow.py", "glow.toml")):
        (tmp_path / missing).rename(tmp_path / there)
        (tmp_path / there).write_text("mine")
        assert call("new", "effect", "glow") == 2
        assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(there, "mine")]


def test_the_store_keeps_every_entry_of_a_study_that_is_named_by_its_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.commands import store
    from novags.testbed.ledger.pruning import KEY
    from novags.testbed.study import plan
    from novags.testbed.study.curves import measuring

    monkeypatch.setattr(measuring, "read_any", lambda _: None)
    monkeypatch.setattr(plan, "plan_of", lambda *_, **__: SimpleNamespace(tasks={c * 64: None for c in "ab"}))
    assert store._ends(tmp_path / "study.toml", tmp_path) == {"a" * KEY, "b" * KEY}


def test_a_dry_run_within_a_budget_says_every_line(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.testbed.study import place
    from novags.testbed.study.budget import within

    monkeypatch.setattr(place, "refuse_impossible", lambda _: None)
    monkeypatch.setattr(within, "told", lambda *_, **__: (None, ["a trial", "settings"]))
    assert call("run", "--budget", "60s", "--dry-run", "--out", str(tmp_path / "out")) == 0
    said = capsys.readouterr().err
    assert "a trial" in said
    assert "settings" in said


@pytest.mark.parametrize("commits", [(None, "1234"), ("1234", None)])
def test_a_comparison_lays_out_both_sides_runs_every_method_and_says_and_writes_every_row(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    commits: tuple[str | None, ...],
) -> None:  # fmt: skip
    from novags.commands.study import BELOW
    from novags.testbed.study.versions import pairs, sides, verdict

    laid, asked = list[str](), list[str]()
    two = [
        SimpleNamespace(role=role, said=f"the {role}", method=None, commit=commit, lay_out=partial(laid.append, role))
        for role, commit in zip(("base", "changed"), commits, strict=True)
    ]

    def fitted(_: Any, __: Any, words: dict[str, Any], *___: Any) -> list[Any]:
        asked.extend(words)
        return [SimpleNamespace(method=method) for method in words]

    def judged(names: dict[str, str], found: list[Any]) -> Any:
        (method,) = (pair.method for pair in found)
        rows = [{"scene": scene, "difference": 1} for scene in ("cornell", "busts")]
        said = [" less ".join(names.values()), f"{method} is judged"]
        return SimpleNamespace(rows=rows, lines=lambda: said, record=dict, below=method == "nova")

    monkeypatch.setattr(sides, "sides_of", lambda *_: two)
    monkeypatch.setattr(pairs, "given", lambda *_: [])
    monkeypatch.setattr(pairs, "fit_pairs", fitted)
    monkeypatch.setattr(verdict, "ComparisonVerdict", judged)
    out = tmp_path / "out"
    words = ("compare", "one", "two", "--methods", "naive", "nova", "--captures", str(tmp_path), "--out", str(out))
    assert call(*words, "--dry-run") == 0
    planned = capsys.readouterr().err
    assert all(f" {name} " in planned for name in ("code", "base", "changed", "logs", "compare.json", "compare.csv"))
    assert not laid
    assert call(*words) == BELOW
    assert laid == ["base", "changed"]
    assert asked == ["naive", "nova"]
    said = capsys.readouterr().out
    assert all(f"{name}:\nthe base less the changed\n{name} is judged\n" in said for name in asked)
    assert (out / "compare.csv").read_text().splitlines()[1:] == [
        f"{method},{scene},1" for method in asked for scene in ("cornell", "busts")
    ]


def test_a_comparison_takes_every_variant_and_bounds_every_seed(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.testbed.study.versions import pairs

    seen = dict[str, Any]()
    monkeypatch.setattr(pairs, "given", lambda *_: [])
    monkeypatch.setattr(pairs, "fit_pairs", lambda _, __, words, *___: seen.update(words) or [])
    texts = [f"{name}=naive:fit.dssim_weight={weight}" for name, weight in (("half", 0.5), ("most", 0.9))]
    words = ("compare", "half", "most", *(word for text in texts for word in ("--variant", text)), "--captures",
             str(tmp_path), "--out", str(tmp_path / "out"), "--seeds")  # fmt: skip
    assert call(*words, "0") == 0
    assert {name: list(told[-2:]) for name, told in seen.items()} == {
        name: ["--variant", text] for name, text in zip(("half", "most"), texts, strict=True)
    }
    for seeds in (("0", "-1"), ("-1", "0")):
        assert call(*words, *seeds) == 2
        assert "seed must be >= 0" in capsys.readouterr().err


def test_the_noise_of_a_twin_is_compared_with_the_real_one_in_this_order_unless_it_is_not_wanted(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from novags.testbed.study.versions import twins

    def both(*folders: Any) -> Any:
        return [SimpleNamespace(methods=[f"best of {f.name}"], pictures=lambda f=f: f.name) for f in folders[:2]]

    def judged(*given: Any) -> Any:
        twin, real, against, noise = given
        return SimpleNamespace(lines=lambda: [f"{twin.pictures()} and {real.pictures()}, {against}, {noise}"])

    monkeypatch.setattr(twins, "both_sides", both)
    monkeypatch.setattr(twins, "noise_ratios", lambda twin, real: f"noise of {twin} over {real}")
    monkeypatch.setattr(twins, "TwinVerdict", judged)
    words = ("compare-sets", str(tmp_path / "twin"), str(tmp_path / "real"))
    for name in ("twin", "real"):
        (tmp_path / name).mkdir()
    assert call(*words) == 0
    assert call(*words, "--no-noise") == 0
    assert capsys.readouterr().out.splitlines() == [
        "twin and real, best of twin, noise of twin over real", "twin and real, best of twin, []"
    ]  # fmt: skip


def test_a_reference_is_refused_where_it_would_choose_nothing(
    call: Call, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert call("score", str(tmp_path), "--reference", "linear") == 2
    assert "--reference linear belongs to --renders" in capsys.readouterr().err


@pytest.mark.parametrize("inside", ["renders", "set"])
def test_scores_of_pictures_are_not_written_into_what_they_are_made_of(
    call: Call, capsys: pytest.CaptureFixture[str], tmp_path: Path, inside: str
) -> None:
    words = ("score", "--renders", str(tmp_path / "renders"), "--set", str(tmp_path / "set"))
    assert call(*words, "--out", str(tmp_path / inside / "scores.json")) == 2
    assert "must not lie inside its input" in capsys.readouterr().err


@pytest.mark.parametrize(("level", "said"), [("mvtv", True), ("lom", False)])
def test_after_a_capture_at_a_level_of_16_bits_the_next_command_takes_them(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, level: str,
    said: bool,
) -> None:  # fmt: skip
    """Rationale: without a word the next step took its 8-bit pictures, which are nearly black."""
    from novags.testbed import stages

    monkeypatch.setattr(stages, "capture", lambda *_, **__: {})
    assert call("capture", str(tmp_path), "--level", level, "--out", str(tmp_path / "cap")) == 0
    assert ("--pictures 16bit" in capsys.readouterr().err) == said


def test_doctor_says_where_kernels_are_kept_when_the_package_may_not_be_written_to(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Rationale: it said that they are compiled anew each time."""
    from novags.commands.answers import doctor

    home = str(tmp_path)
    monkeypatch.setattr("os.access", lambda place, _: str(place).startswith(home))
    monkeypatch.setenv("XDG_CACHE_HOME", home)
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    finding = doctor._kernels()
    assert (finding.state, finding.detail.endswith(str(tmp_path / "novags"))) == ("ok", True)
    monkeypatch.setattr("os.access", lambda *_: False)
    assert doctor._kernels().state == "missing"
