"""Claims about what a stage says: why a result is made again, why it is kept, and what it would do."""

import re
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.ledger import stage as stages
from novags.testbed.ledger.code import Code
from novags.testbed.ledger.contents import write_json
from novags.testbed.ledger.dry import dry_run, planned

CODE = Code({"a.py": "1", "b.py": "1"}, {"a.py": "whole 1", "b.py": "whole 1"})


def stage(folder: Path, work, *, overwrite: bool = True, code: Code = CODE, console: Console | None = None):
    return stages.run_stage(
        "toy", folder, "record.json", code=code, inputs=lambda: {"in": "1"}, config={},
        owns=("record.json", "a.txt"), prepare=lambda: None, work=lambda _: work(),
        console=console or Console(quiet=True), overwrite=overwrite,
    )  # fmt: skip


def writes(folder: Path, calls: list[str]):
    def work():
        calls.append("called")
        (folder / "a.txt").write_text("a")
        return {"answer": 42}

    return work


def said(capsys: pytest.CaptureFixture[str]) -> str:
    """What was printed, on one line."""
    captured = capsys.readouterr()
    return " ".join((captured.out + captured.err).split())


def test_with_other_code_the_same_request_is_made_again_and_said_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[str] = []
    stage(tmp_path, writes(tmp_path, calls))
    other = Code({"a.py": "2", "b.py": "1"}, {"a.py": "whole 2", "b.py": "whole 1"})
    stage(tmp_path, writes(tmp_path, calls), overwrite=False, code=other, console=Console())
    assert calls == ["called", "called"]
    assert re.search(r"made again in .*: a\.py has changed since \d+ \w+, \d\d:\d\d", said(capsys))
    stage(tmp_path, writes(tmp_path, calls), overwrite=False, code=other)
    assert calls == ["called", "called"]


@pytest.mark.parametrize("change", ["nothing", "code", "a file"])
def test_a_dry_run_says_what_would_be_done_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    def tree() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}

    with dry_run() as kept:
        stage(tmp_path / "new", writes(tmp_path, []), console=Console())
    assert kept == [False]
    assert not (tmp_path / "new").exists()
    assert "to be made in" in said(capsys)
    stage(tmp_path, writes(tmp_path, []))
    if change == "a file":
        (tmp_path / "a.txt").write_text("b")
    before, calls = tree(), list[str]()
    code = Code({"a.py": "2", "b.py": "1"}, {}) if change == "code" else CODE
    with dry_run() as kept:
        stage(tmp_path, writes(tmp_path, calls), code=code, console=Console())
    assert kept == [change == "nothing"]
    assert (calls, tree()) == ([], before)
    words = {"nothing": "unchanged, kept", "code": "a.py has changed since", "a file": "a.txt not as written"}
    assert words[change] in said(capsys)
    with dry_run(False):
        stage(tmp_path, writes(tmp_path, calls), code=code)
    assert calls == ([] if change == "nothing" else ["called"])


def test_where_only_texts_changed_the_result_is_kept_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[str] = []
    stage(tmp_path, writes(tmp_path, calls))
    stage(tmp_path, writes(tmp_path, calls), code=Code(CODE.files, {**CODE.texts, "b.py": "2"}), console=Console())
    assert calls == ["called"]
    assert "only texts, or code it does not use, changed in b.py" in said(capsys)


def test_a_result_whose_code_was_not_recorded_is_not_replaced_unasked(tmp_path: Path) -> None:
    record = stage(tmp_path, writes(tmp_path, []))
    del record["stage"]["code"]
    write_json(tmp_path / "record.json", {**record, "stage": {**record["stage"], "key": "of version 0.1.0"}})
    with pytest.raises(ValueError, match=r"made by novags [\d.]+, which recorded no code"):
        stage(tmp_path, writes(tmp_path, []), overwrite=False)
    assert stage(tmp_path, writes(tmp_path, []))["answer"] == 42


def test_every_file_that_would_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "b.txt").touch()
    with dry_run():
        planned(Console(), "toy", [tmp_path / "a.txt", tmp_path / "b.txt"])
    text = said(capsys).replace(" ", "")
    assert f"toy:tobemadein{tmp_path}:a.txt(" in text
    assert f"toy:tobemadeagainin{tmp_path}:b.txtisthere(" in text
