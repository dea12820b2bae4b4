"""Claims about stages as folders."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from novags.testbed.console.terminal import Console
from novags.testbed.ledger import stage as stages
from novags.testbed.ledger.code import Code
from novags.testbed.ledger.contents import UNFINISHED, checksum, read_json, refuse_damage, write_json
from novags.testbed.ledger.stage import run_stage
from sensor_model.files.atomic import appending, atomic, write_text

QUIET = Console(quiet=True)
CODE = Code({"a.py": "1", "b.py": "1"}, {"a.py": "whole 1", "b.py": "whole 1"})


def stage(
    folder: Path, work, *, config: dict | None = None, inputs: dict | None = None, prepare=lambda: None, overwrite=True,
    code: Code = CODE, console: Console = QUIET, stale=(),
):  # fmt: skip
    return run_stage(
        "toy",
        folder,
        "record.json",
        code=code,
        inputs=lambda: inputs or {"in": "1"},
        config=config or {},
        owns=("a.txt", "parts", "record.json"),
        prepare=prepare,
        work=lambda _: work(),
        console=console,
        stale=stale,
        overwrite=overwrite,
    )


def writes(folder: Path, calls: list[str]):
    def work():
        calls.append("called")
        (folder / "a.txt").write_text("a")
        return {"answer": 42}

    return work


def test_a_finished_stage_is_not_run_again(tmp_path: Path) -> None:
    calls: list[str] = []
    first = stage(tmp_path, writes(tmp_path, calls))
    second = stage(tmp_path, writes(tmp_path, calls))
    assert calls == ["called"]
    assert first == second
    assert first["answer"] == 42


@pytest.mark.parametrize(
    ("old", "new"), [('"a": 1', '"a": 2'), ('"in": "1"', '"in": "2"'), ('"answer": 42', '"answer": 43')]
)
def test_an_edited_record_is_refused(tmp_path: Path, old: str, new: str) -> None:
    stage(tmp_path, writes(tmp_path, []), config={"a": 1})
    path = tmp_path / "record.json"
    refuse_damage(tmp_path, read_json(path)["stage"], "make it again")
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ValueError, match=r"record(.json)? not as written .checksum.; put back the original, or make"):
        refuse_damage(tmp_path, read_json(path)["stage"], "make it again")


def remove(file: Path) -> None:
    file.unlink()


def flip(file: Path) -> None:
    file.write_bytes(bytes([file.read_bytes()[0] ^ 1]))


def replace_by_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


@pytest.mark.parametrize("harm", [remove, flip, replace_by_folder])
def test_damaged_files_of_a_finished_stage_are_refused_and_made_again_on_request(tmp_path: Path, harm) -> None:
    calls: list[str] = []
    first = stage(tmp_path, writes(tmp_path, calls))
    (tmp_path / "parts").mkdir()  # what came later is not the stage's
    (tmp_path / "parts" / "later.txt").write_text("later")
    harm(tmp_path / "a.txt")
    for check in (
        lambda: stage(tmp_path, writes(tmp_path, calls), overwrite=False),
        lambda: stages.refuse_other(tmp_path, "record.json", {}),
    ):
        with pytest.raises(ValueError, match=r"a\.txt not as written \(checksum\); put back .* add --overwrite"):
            check()
    assert calls == ["called"]
    write_json(tmp_path / UNFINISHED, {"stage": "toy", "record": "record.json", "key": first["stage"]["key"]})
    again = stage(tmp_path, writes(tmp_path, calls))
    assert calls == ["called", "called"]
    assert (tmp_path / "a.txt").read_text() == "a"
    assert again["stage"]["files"] == first["stage"]["files"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [".record.json", "a.txt", "record.json"]


def test_results_of_earlier_versions_which_kept_no_checksums_stay(tmp_path: Path) -> None:
    calls: list[str] = []
    record = stage(tmp_path, writes(tmp_path, calls))
    del record["stage"]["files"]
    write_json(tmp_path / "record.json", record)
    (tmp_path / "a.txt").write_text("b")
    assert stage(tmp_path, writes(tmp_path, calls), overwrite=False) == record
    assert calls == ["called"]


@pytest.mark.parametrize("change", [{"config": {"x": 2}}, {"inputs": {"in": "2"}}])
def test_a_changed_configuration_or_input_runs_the_stage_on_a_clean_folder(tmp_path: Path, change: dict) -> None:
    calls: list[str] = []
    stage(tmp_path, writes(tmp_path, calls))

    def again():
        assert not (tmp_path / "a.txt").exists()
        return writes(tmp_path, calls)()

    stage(tmp_path, again, **change)
    assert calls == ["called", "called"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"config": {"light": 5.0, "fit": {"steps": 9}}}, r"\(light was 20.0, is 5.0, fit.steps was absent, is 9\)"),
        ({"inputs": {"in": "2"}, "config": {"light": 20.0}}, r"\(another in\)"),
    ],
)
def test_a_finished_result_is_not_replaced_by_another_request_unless_that_is_said(
    tmp_path: Path, change: dict, said: str
) -> None:
    calls: list[str] = []
    stage(tmp_path, writes(tmp_path, calls), config={"light": 20.0})
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(ValueError, match=f"finished result of another request {said}: choose .* add --overwrite"):
        stage(tmp_path, writes(tmp_path, calls), **change, overwrite=False)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    stage(tmp_path, writes(tmp_path, calls), config={"light": 20.0}, overwrite=False)
    assert calls == ["called"]


def test_a_replacement_that_was_interrupted_goes_on_without_being_asked_for_again(tmp_path: Path) -> None:
    def interrupted():
        raise KeyboardInterrupt

    stage(tmp_path, writes(tmp_path, []))
    with pytest.raises(KeyboardInterrupt):
        stage(tmp_path, interrupted, config={"x": 1})
    assert stage(tmp_path, writes(tmp_path, []), config={"x": 1}, overwrite=False)["answer"] == 42


def test_an_interrupted_stage_finds_what_it_had_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    peaks = [7, 3]  # bytes, of the first attempt and of the second
    monkeypatch.setattr(stages, "PeakMemory", lambda: SimpleNamespace(peak_bytes=partial(int, peaks.pop(0))))

    def interrupted():
        (tmp_path / "a.txt").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage(tmp_path, interrupted)
    assert not (tmp_path / "record.json").exists()
    assert (tmp_path / UNFINISHED).exists()

    def resumed():
        assert (tmp_path / "a.txt").read_text() == "half"
        return {}

    record = stage(tmp_path, resumed)
    assert not (tmp_path / UNFINISHED).exists()
    assert record["stage"]["seconds"] > 0
    assert record["stage"]["peak_bytes"] == 7


def test_an_interrupted_stage_starts_afresh_under_another_configuration(tmp_path: Path) -> None:
    def interrupted():
        (tmp_path / "a.txt").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage(tmp_path, interrupted)
    stage(tmp_path, lambda: {"had": (tmp_path / "a.txt").exists()}, config={"x": 1})
    assert read_json(tmp_path / "record.json")["had"] is False


def test_an_input_that_changes_under_a_stage_is_noticed_and_nothing_is_kept(tmp_path: Path) -> None:
    inputs = {"in": "1"}

    def work() -> dict:
        inputs["in"] = "2"
        return writes(tmp_path, [])()

    with pytest.raises(ValueError, match="toy: the in that it reads changed while it was at work: its result in"):
        stage(tmp_path, work, inputs=inputs)
    assert not (tmp_path / "record.json").exists()
    again: list[str] = []
    assert stage(tmp_path, writes(tmp_path, again), inputs=inputs)["answer"] == 42
    assert again == ["called"]


def test_a_wrong_input_costs_no_finished_work(tmp_path: Path) -> None:
    stage(tmp_path, writes(tmp_path, []))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def refuse() -> None:
        raise ValueError("an input is damaged")

    with pytest.raises(ValueError, match="damaged"):
        stage(tmp_path, writes(tmp_path, []), config={"x": 1}, prepare=refuse)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_an_interruption_while_clearing_leaves_nothing_that_counts_as_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fills() -> dict:
        (tmp_path / "parts").mkdir()
        (tmp_path / "parts" / "0").write_text("old")
        return writes(tmp_path, [])()

    def interrupted(_: Path) -> None:
        raise KeyboardInterrupt

    stage(tmp_path, fills)
    with monkeypatch.context() as patch:
        patch.setattr("shutil.rmtree", interrupted)
        with pytest.raises(KeyboardInterrupt):
            stage(tmp_path, fills, config={"x": 1})
    assert (tmp_path / "parts" / "0").exists()
    for config in ({"x": 1}, {}):  # the same work once more, then that of before
        record = stage(tmp_path, lambda: {"had": (tmp_path / "parts").exists()}, config=config)
        assert record["had"] is False


def test_files_of_other_origin_are_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("precious")
    with pytest.raises(ValueError, match="already holds a.txt"):
        stage(tmp_path, writes(tmp_path, []))
    assert (tmp_path / "a.txt").read_text() == "precious"


def test_a_record_of_other_origin_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "record.json").write_text("{}")
    with pytest.raises(ValueError, match="did not write it"):
        stage(tmp_path, writes(tmp_path, []))


def test_unfinished_work_of_another_stage_is_not_taken_over(tmp_path: Path) -> None:
    def interrupted() -> None:
        (tmp_path / "a.txt").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage(tmp_path, interrupted)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    other = {"inputs": dict, "config": {}, "owns": ("b.txt",), "prepare": lambda: None, "work": lambda _: {}}
    with pytest.raises(ValueError, match="holds unfinished work of novags toy: finish that, or choose another --out"):
        run_stage("other", tmp_path, "other.json", code=CODE, **other, console=QUIET)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_kill_after_the_record_was_written_leaves_nothing_once_the_stage_has_been_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def work(_: None) -> dict:
        (tmp_path / "scrap").write_text("needed until the record is there")
        return {}

    def ask() -> None:
        owned = {"code": CODE, "inputs": dict, "config": {}, "owns": ("scrap",), "scrap": ("scrap",)}
        run_stage("toy", tmp_path, "record.json", **owned, prepare=lambda: None, work=work, console=QUIET)

    with monkeypatch.context() as patch:
        patch.setattr(stages._Stage, "_tidy", lambda _: None)
        ask()
    assert sorted(p.name for p in tmp_path.iterdir()) == [".record.json", "record.json", "scrap", UNFINISHED]
    ask()
    assert sorted(p.name for p in tmp_path.iterdir()) == [".record.json", "record.json"]


@pytest.mark.parametrize(
    "shortage",
    [
        MemoryError(),
        MemoryError("Unable to allocate 4.00 GiB for an array"),
        RuntimeError(
            "[enforce fail at alloc_cpu.cpp:124] DefaultCPUAllocator: can't allocate memory: you tried to ..."
        ),
        RuntimeError("jit_malloc(): out of memory! Could not allocate 4096 bytes"),
        OSError(12, "Cannot allocate memory"),
        ValueError("the scene cannot be loaded: rough.so: failed to map segment from shared object"),
        torch.cuda.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB"),
    ],
)
def test_too_little_memory_is_one_line_that_says_what_to_do(tmp_path: Path, shortage: Exception) -> None:
    def work() -> None:
        raise shortage

    with pytest.raises(MemoryError, match=r"^toy: .*memory is not enough .*: finished work is kept; .* fewer points"):
        stage(tmp_path, work)


@pytest.mark.parametrize(
    "other", [RuntimeError("the sky is blue"), ValueError("out of memory of a camera"), OSError(28)]
)
def test_other_errors_are_not_taken_for_too_little_memory(tmp_path: Path, other: Exception) -> None:
    def work() -> None:
        raise other

    with pytest.raises(type(other)):
        stage(tmp_path, work)


def test_files_beside_the_stages_own_survive_it(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    stage(tmp_path, writes(tmp_path, []))
    stage(tmp_path, writes(tmp_path, []), config={"x": 3})
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_all_that_describes_a_replaced_result_goes_with_it(tmp_path: Path) -> None:
    described = [tmp_path / name for name in ("report.html", "table.csv")]
    for file in described:
        file.write_text("of the result")
    stage(tmp_path / "out", writes(tmp_path / "out", []), stale=described)  # a first result: they are of something else
    assert all(file.exists() for file in described)
    stage(tmp_path / "out", writes(tmp_path / "out", []), stale=described, config={"x": 1})
    assert not any(file.exists() for file in described)


def test_a_record_says_what_it_cost_and_what_made_it(tmp_path: Path) -> None:
    record = stage(tmp_path, writes(tmp_path, []), config={"x": 1})["stage"]
    assert record["peak_bytes"] > 1 << 20
    assert record["seconds"] >= 0
    assert record["config"] == {"x": 1}
    assert {"python", "numpy", "torch", "novags"} <= record["versions"].keys()
    assert {"processor", "cores", "memory_bytes", "gpu"} <= record["hardware"].keys()


@pytest.mark.parametrize("name", ["a.txt", "parts/b.txt", "parts/inner/c.json"])
def test_a_file_that_another_hand_changes_while_a_stage_is_at_work_is_never_sealed(tmp_path: Path, name: str) -> None:
    def work() -> dict[str, int]:
        assert [path.name for path in tmp_path.iterdir() if path.name[0] != "."] == [
            UNFINISHED
        ]  # nothing to go on from
        write_text(tmp_path / "a.txt", "a")
        with atomic(tmp_path / "parts") as temporary:
            (temporary / "inner").mkdir(parents=True)
            (temporary / "b.txt").write_text("b")
            (temporary / "inner" / "c.json").write_text("[1]")
        write_text(tmp_path / "a.txt", "its last content")
        if harmed:
            (tmp_path / name).write_text("[2]")
        return {}

    harmed = True
    with pytest.raises(ValueError, match=f"toy: .*{name}, which it wrote, was changed while it was at work"):
        stage(tmp_path, work)
    assert not (tmp_path / "record.json").exists()
    harmed = False
    assert stage(tmp_path, work)["stage"]["files"].keys() == {
        "a.txt", "parts/b.txt", "parts/inner/c.json", "record.json",
    }  # fmt: skip


def test_a_log_that_grows_while_a_stage_is_at_work_is_sealed_as_it_is_in_the_end(tmp_path: Path) -> None:
    def work() -> dict[str, int]:
        write_text(tmp_path / "a.txt", "one ")
        with appending(tmp_path / "a.txt") as file:
            file.write(b"two")
        return {}

    sealed = stage(tmp_path, work)["stage"]["files"]["a.txt"]
    assert sealed == checksum(tmp_path / "a.txt")
