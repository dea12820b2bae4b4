"""Claims about tables as CSV: nothing in them runs in a spreadsheet, and names are read back as they were."""

import csv
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.console.csv_text import as_csv, text_of
from novags.testbed.dataset.publish import write_index
from novags.testbed.report.blocks import light

FORMULAS = ["=1+cmd|' /C calc'!A0", "+1+1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "＝1"]


def read(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines(keepends=True)))


@pytest.mark.parametrize("text", FORMULAS)
def test_text_that_a_spreadsheet_would_compute_is_marked_as_text(text: str) -> None:
    heads, *cells = csv.reader(as_csv([{text: text}]).splitlines(keepends=True))
    assert heads[0][0] == "'"
    assert cells[0][0][0] == "'"


@pytest.mark.parametrize("text", [*FORMULAS, "'", "'=1", "''", "plain", 'a "b", c', "-", "two\nlines"])
def test_every_text_is_read_back_as_it_was(text: str) -> None:
    (row,) = read(as_csv([{"name": text}]))
    assert text_of(row["name"]) == text


def test_numbers_stay_numbers_and_what_there_is_not_is_empty() -> None:
    rows: list[dict[str, Any]] = [{"a": -1.5, "b": "-3e-4", "c": None}, {"a": float("-inf"), "d": True}]
    assert as_csv(rows) == "a,b,c,d\n-1.5,-3e-4,,\n-inf,,,True\n"
    assert as_csv(rows, ["d", "a"]) == "d,a\n,-1.5\nTrue,-inf\n"
    assert as_csv([]) == "\n"


def test_a_data_set_index_and_the_curves_of_a_study_are_written_so(tmp_path: Path) -> None:
    class View:
        row = {"scene": "=1+cmd", "split": "train", "dark": "train/a.png", "lit": "train/b.png"}

    (tmp_path / "train").mkdir()
    write_index([View(), View()], tmp_path)  # type: ignore[list-item]
    line = "'=1+cmd,train,train/a.png,train/b.png\n"
    assert (tmp_path / "index.csv").read_text() == f"scene,split,dark,lit\n{line}{line}"
    assert light.as_csv is as_csv
