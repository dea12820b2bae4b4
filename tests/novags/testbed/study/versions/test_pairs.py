"""Claims about the captures and the fits of a comparison: which there are, with which seed, by which side first."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as captures
from novags.testbed.folders.run import RECORD
from novags.testbed.study.versions import pairs
from novags.testbed.study.versions.pairs import FittedCase, fit_pairs

QUIET = Console(quiet=True)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """A capture by its path alone: the name ends in the seed of its noise, and begins with the content of its set."""

    def capture(path: Path) -> Any:
        content, _, seed = (path.parent if path.name == "capture" else path).name.partition("-")
        record = SimpleNamespace(simulated=SimpleNamespace(noise_seed=int(seed)) if seed else None)
        return SimpleNamespace(path=path, record=record, source=lambda _: SimpleNamespace(content=content))

    def run(path: Path) -> Any:
        return SimpleNamespace(capture=lambda: SimpleNamespace(path=Path((path / RECORD).read_text())))

    monkeypatch.setattr(pairs, "open_capture", capture)
    monkeypatch.setattr(pairs, "open_run", run)


def folder(place: Path) -> Path:
    place.mkdir(parents=True)
    (place / captures.RECORD).touch()
    return place


@pytest.mark.usefixtures("opened")
def test_every_capture_is_fitted_with_every_seed_and_captures_of_one_set_are_of_one_scene(tmp_path: Path) -> None:
    made, other = folder(tmp_path / "cube-7"), folder(tmp_path / "cube-8")
    inside, real = folder(tmp_path / "room-9" / "capture"), folder(tmp_path / "photographs")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / RECORD).write_text(str(other))
    folders = [made, tmp_path / "run", inside.parent, real, made]
    found = pairs.given(folders, (3, 4), QUIET)
    assert found == [
        FittedCase(path.resolve(), scene, noise, seed)
        for path, scene, noise in ((made, "cube-7", "7"), (other, "cube-7", "8"), (inside, "room-9", "9"),
                                   (real, "photographs", ""))
        for seed in (3, 4)
    ]  # fmt: skip
    assert [case.name for case in found[4:6]] == ["room-9-s3", "room-9-s4"]


@pytest.mark.usefixtures("opened")
def test_folders_of_nothing_and_captures_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is no folder of a capture, a run or an experiment"):
        pairs.given([folder(tmp_path / "cube-7"), tmp_path], (0,), QUIET)
    alike = [folder(tmp_path / name) for name in ("first-1", "a/cube-7", "b/cube-7")]
    for folders, seeds in ((alike, (0, 1)), (alike[1:], (0,))):
        with pytest.raises(ValueError, match="two captures are called cube-7: rename one"):
            pairs.given(folders, seeds, QUIET)


def test_every_capture_that_is_made_is_fitted_with_the_seed_of_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = [{"scene": scene, "seed": seed} for scene, seed in (("cube", 1), ("room", 2))]
    rows = [{**value, "state": "done", "reason": "no light"} for value in values]
    plan: Any = SimpleNamespace(
        runs=[(SimpleNamespace(values=value), value["scene"]) for value in values],
        tasks={name: SimpleNamespace(folder=lambda store, name=name: store / name) for name in ("cube", "room")},
    )
    monkeypatch.setattr(pairs, "conduct", lambda *_, **__: rows)
    found = pairs.make(plan, tmp_path / "captures", tmp_path, QUIET)
    assert found == [FittedCase(tmp_path / "cube", "cube", "1", 1), FittedCase(tmp_path / "room", "room", "2", 2)]
    rows[1]["state"] = "failed"
    with pytest.raises(ValueError, match="no capture of room: no light"):
        pairs.make(plan, tmp_path / "captures", tmp_path, QUIET)


@pytest.mark.parametrize(("methods", "names"), [((None, None), ("naive", "nova")), (("naive", "nova"), ("naive",))])
def test_every_case_and_method_is_a_pair_and_the_sides_take_turns_to_be_first(
    methods: tuple[str | None, str | None], names: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two checkouts run all methods; of two methods each side runs its own."""
    fits = list[tuple[str, tuple[str, ...], str, str]]()

    def side(role: str, method: str | None) -> Any:
        def fit(line: list[str], out: Path, log: Path) -> float:
            fits.append((role, tuple(line), str(out.relative_to(tmp_path)), log.name))
            return float(len(fits))

        return SimpleNamespace(role=role, method=method, fit=fit)

    monkeypatch.setattr(pairs, "open_run", lambda path: SimpleNamespace(path=path))
    monkeypatch.setattr(pairs.stages, "score", lambda path, _: {"methods": {path.name: {"of": path.parent.name}}})
    cases = [FittedCase(tmp_path / "cube", "cube", "7", 3), FittedCase(tmp_path / "room", "room", "", 4)]
    words = {"naive": ["--points", "9"], "nova": ["--points", "8"]}
    sides: Any = tuple(map(side, ("base", "changed"), methods))
    found = fit_pairs(sides, cases, words, tmp_path, QUIET)
    wanted = [(case, name) for case in cases for name in names]
    assert [(pair.case, pair.method) for pair in found] == wanted
    expected = list[tuple[str, tuple[str, ...], str, str]]()
    for k, (case, name) in enumerate(wanted):
        for each in sides if k % 2 == 0 else sides[::-1]:
            own = each.method or name
            line = (str(case.path), "--seed", str(case.seed), "--method", own, *words[own])
            place = f"{case.path.name}-s{case.seed}-{own}"
            expected.append((each.role, line, f"{each.role}/{place}", f"{each.role}-{place}.log"))
    assert fits == expected
    for pair in found:
        assert (pair.base.scores, pair.changed.scores) == ({"of": "base"}, {"of": "changed"})
        assert pair.base.cpu_seconds != pair.changed.cpu_seconds
