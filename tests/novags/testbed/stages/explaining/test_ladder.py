"""Claims about the ladder: errors decide what is said, and what cannot be tried is named with its reason."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.cameras import parse_cameras
from novags.methods.variant import Variant
from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import EXPLAINED
from novags.testbed.ledger.contents import jsonable
from novags.testbed.metrics.differences import Estimate
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.explaining import ladder as module
from novags.testbed.stages.explaining.ladder import (
    RECORD,
    TABLE,
    Ladder,
    _ladder,
    cases_of,
    changes_of,
    explain,
    forecast,
    made,
)
from novags.testbed.stages.explaining.more import MORE
from novags.testbed.stages.explaining.swaps import SWAPS, Case, NotSwapped


def gain(value: float, error: float | None) -> Estimate:
    return Estimate(value, error, 5.0, "" if error is None else "views", 1, 1, 6)


def ladder(**won: Estimate) -> Ladder:
    return Ladder("naive", "psnr", 20.0, won, {"colours": "not defined"})


def test_the_sentence_names_the_first_cause_and_claims_no_more_than_its_error_allows() -> None:
    assert ladder(noise=gain(3.0, 0.1), views=gain(1.0, 0.1)).first.startswith("Most is lost to noise: ")
    assert "is not seen to be a gain" in ladder(noise=gain(0.1, 0.1)).first
    assert ladder(noise=gain(-0.5, 0.1)).first.startswith("No truth alone wins anything")
    assert "no error is known" in ladder(views=gain(8.0, None)).first
    assert "could be replaced" in ladder().first


def test_a_cause_that_is_not_seen_to_be_smaller_is_named_beside_the_first(tmp_path: Path) -> None:
    """Gains by view: of noise and views they cross, cameras win less in each."""
    gains = {
        name: {("s", "0", str(view)): value for view, value in enumerate(values)}
        for name, values in {"noise": (3.0, 2.0, 2.6), "views": (2.0, 3.0, 2.4), "cameras": (1.0, 0.3, 0.7),
                             "points": (-1.0, 1.5, -2.0)}.items()
    }  # fmt: skip
    own = {key: 20.0 for key in gains["noise"]}
    found = _ladder(case(tmp_path), own, gains, {})
    assert found.level == ("views",)
    assert found.first.endswith("; views may be as much.")
    one = {name: dict(list(values.items())[:1]) for name, values in gains.items()}
    assert _ladder(case(tmp_path), own, one, {}).level == ()  # of one view no error is known


def test_what_was_not_replaced_is_printed_with_its_reason() -> None:
    said = "\n".join(ladder(noise=gain(3.0, 0.1)).lines())
    assert "colours   not replaced: not defined" in said
    assert ladder().record()["not_swapped"] == {"colours": "not defined"}


def case(tmp_path: Path, *, imported: bool = False, cameras: str = "known", seed: int = 0, **scores: Any) -> Case:
    """A run of naive, of which nothing is on disk."""
    config = ReconstructConfig(variant=Variant(name="naive", method="naive"), cameras=parse_cameras(cameras))
    capture = SimpleNamespace(
        imported=imported, holds=lambda part: not imported, record=SimpleNamespace(simulated=None), path=tmp_path
    )
    source = SimpleNamespace(scaled=False, views=SimpleNamespace(kind="photographs", meta={}, geometry=lambda i: None))
    run = SimpleNamespace(path=tmp_path, name="naive", method="naive", record={"seed": seed})
    values = {"tone_aligned_psnr": 21.0, "psnr": 20.0}
    found = Case(run, capture, source, {"mean": {"enhanced": values}, "views": {"0": {"enhanced": values}}} | scores)  # type: ignore[arg-type]
    vars(found)["config"] = config
    return found


def test_photographs_have_no_truth_but_the_tone_and_the_length(tmp_path: Path) -> None:
    found = changes_of(case(tmp_path, imported=True, cameras="known:rotation_deg=1"), list(SWAPS))
    assert [name for name, change in found.items() if not isinstance(change, NotSwapped)] == ["tone", "length"]
    assert all(str(change) for change in found.values())


def test_ingredients_that_are_true_already_are_not_replaced(tmp_path: Path) -> None:
    found = changes_of(case(tmp_path), list(SWAPS))
    assert "true ones already" in str(found["cameras"])
    told = case(tmp_path, cameras="da3:checkpoint=w,known=cameras")  # first points are the network's
    assert "true ones already" in str(changes_of(told, ["cameras"])["cameras"])
    alone: Any = changes_of(case(tmp_path, cameras="da3:checkpoint=w"), ["cameras"])["cameras"]
    assert alone.cameras == parse_cameras("known")


def test_cameras_are_swapped_alone(tmp_path: Path) -> None:
    before = case(tmp_path, cameras="known:rotation_deg=1")
    found: Any = changes_of(before, ["cameras"])["cameras"]
    assert found.cameras == parse_cameras("known")
    assert (found.config, found.given, found.more) == (before.config.config, "", None)


def test_the_length_is_the_best_along_the_fit_and_twice_the_iterations_without(tmp_path: Path) -> None:
    twice: Any = changes_of(case(tmp_path), ["length"])["length"]
    assert twice.config.fit.iterations == 2 * case(tmp_path).config.config.fit.iterations
    along = [{"iterations": at, "mean": {"enhanced": {"tone_aligned_psnr": value}},
              "views": {"0": {"enhanced": {"tone_aligned_psnr": value}}}}
             for at, value in ((10, 19.0), (20, 23.0))]  # fmt: skip
    best: Any = changes_of(case(tmp_path, along=along), ["length"])["length"]
    assert list(best.values()) == [23.0]


def test_a_program_is_not_made_again_and_the_reason_is_said(tmp_path: Path) -> None:
    run: Any = SimpleNamespace(path=tmp_path, name="theirs", method="theirs", record={"seed": 0})
    ours = case(tmp_path)
    found = changes_of(Case(run, ours.capture, ours.source, ours.scores), list(SWAPS))
    assert {name for name, change in found.items() if "theirs is a program" in str(change)} == {
        "cameras", "points", "geometry", "length", "views"
    }  # fmt: skip
    assert "name its study file" in str(found["noise"])


@pytest.mark.parametrize("name", SWAPS)
def test_every_row_says_its_truth(name: str) -> None:
    assert SWAPS[name].truth


def test_every_run_that_is_explained_is_forecast_with_its_own_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of more views, a set and a capture are made as well."""
    cases = [case(tmp_path / name) for name in "ab"]
    for k, each in enumerate(cases, 1):
        each.run.record["stage"] = {"seconds": k}
        each.capture.record.stage = {"seconds": 10 * k}
        each.source.views.meta["stage"] = {"seconds": 100 * k}
    changes = {"points": cases[0].config, "views": replace(cases[0].config, more=tmp_path), "colours": NotSwapped("no")}
    monkeypatch.setattr(module, "changes_of", lambda *_: changes)
    wanted = {each.folder(name): seconds for k, each in enumerate(cases, 1)
              for name, seconds in (("points", k), ("views", k + MORE * 110 * k))}  # fmt: skip
    assert forecast(cases, list(changes)) == wanted


def test_the_ladder_of_each_run_is_written_and_the_one_of_all_is_over_their_seeds(tmp_path: Path) -> None:
    cases = [case(tmp_path / str(seed), seed=seed) for seed in (3, 4)]
    found = explain(cases, ["tone", "colours"], Console(quiet=True))
    assert made(cases) == [each.run.path / EXPLAINED / name for each in cases for name in (RECORD, TABLE)]
    assert all(path.exists() for path in made(cases))
    assert (found.won["tone"].value, found.won["tone"].seeds) == (1.0, 2)
    assert list(cases[1].values(cases[1].scores)) == [("", "4/", "0")]
    assert found.not_swapped.keys() == {"colours"}


def test_runs_that_differ_in_more_than_their_seeds_or_in_nothing_are_not_explained_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: runs of two scenes, in other light, were taken for two seeds of one scene."""

    def opened(path: Path) -> Any:
        """Named by the folder, with the seed in the name of the folder above and what is in the name above that."""
        own, seed, (part, _, value) = case(path), int(path.parent.name), path.parent.parent.name.partition("=")
        told: dict[str, dict[str, Any]] = {
            "run": {"points": 60},
            "capture": {"electrons": 20},
            "set": {"scene": "cornell"},
        }
        stages = {what: {"config": {**config, "seed": seed}} for what, config in told.items()}
        if part in stages:
            stages[part]["config"] |= dict.fromkeys(told[part], value)
        capture = SimpleNamespace(record=SimpleNamespace(simulated=None, stage=stages["capture"]))
        source = SimpleNamespace(views=SimpleNamespace(meta={"stage": stages["set"]}), content=str(seed))
        if part == "photographs":
            source = SimpleNamespace(views=SimpleNamespace(meta={}), content=value)
        return SimpleNamespace(name=path.name, path=path, record={"seed": seed, "stage": stages["run"]},
                               scores=lambda: own.scores, inputs=lambda _: (capture, source))  # fmt: skip

    monkeypatch.setattr(module, "score", lambda *_: None)
    monkeypatch.setattr(module, "open_run", opened)
    quiet, first = Console(quiet=True), tmp_path / "0" / "naive"
    with pytest.raises(ValueError, match="must be of one method, got naive, nova"):
        cases_of([first, tmp_path / "1" / "nova"], quiet)
    with pytest.raises(ValueError, match="must differ in their seeds"):
        cases_of([first, tmp_path / "b" / "0" / "naive"], quiet)
    for other, said in (("run=70", "run.points was 60, is 70"), ("capture=5", "capture.electrons was 20, is 5"),
                        ("set=busts", "set.scene was cornell, is busts")):  # fmt: skip
        with pytest.raises(ValueError, match=f"must differ in their seeds alone, and of .*{said}: explain it by"):
            cases_of([first, tmp_path / "1" / "naive", tmp_path / other / "2" / "naive"], quiet)
    photographs = [tmp_path / f"photographs={of}" / seed / "naive" for of, seed in (("a", "0"), ("a", "1"), ("b", "2"))]
    with pytest.raises(ValueError, match="set of was a, is b"):
        cases_of(photographs, quiet)
    assert len(cases_of(photographs[:2], quiet)) == len(cases_of([first, tmp_path / "1" / "naive"], quiet)) == 2


def test_a_program_is_found_among_all_that_are_known(tmp_path: Path) -> None:
    programs = [CommandConfig(name=name, command="ls {capture} {out}", folder=tmp_path) for name in ("ours", "theirs")]
    known = case(tmp_path)
    for program in programs:
        record = {"seed": 5, "stage": {"config": jsonable(replace(program, seed=5).resolved())}}
        run: Any = SimpleNamespace(path=tmp_path, name=program.name, method=program.name, record=record)
        found = Case(run, known.capture, known.source, known.scores, tuple(programs)).program
        assert (found.name, found.seed) == (program.name, 5)
