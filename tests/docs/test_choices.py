"""The table of docs/choices.md: differences, halving and decisions against numbers worked out by hand."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from novags.testbed.study.cells.grid import study_of
from sensor_model.files.toml_file import read_toml

ROOT = Path(__file__).resolve().parents[2]
STUDIES = sorted((ROOT / "docs" / "studies").glob("*.toml"))
AXES = ["scene", "method", "seed"]


@pytest.fixture(scope="module")
def settle(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("choices/settle.py")


def row(scene: str, method: str, seed: int, own: float, lit: float, seconds: float, state: str = "done") -> dict:
    return {
        "scene": scene, "method": method, "seed": seed, "state": state, "reason": "it broke" * (state != "done"),
        "enhanced.aligned_psnr": own, "lit.tone_aligned_psnr": lit, "seconds.reconstruct": seconds,
    }  # fmt: skip


TABLE = {
    "grid": {"scene": ["a", "b"], "method": ["base", "naive", "x.1", "x.2", "y.1"], "seed": [0, 1]},
    "variant": {
        "base": {"method": "m"},
        "x.1": {"method": "m", "fit.w": 1},
        "x.2": {"method": "m", "fit.w": 2},
        "y.1": {"method": "m", "enhance.eta": 0.1, "joint": False, "kind": "A"},
    },
}
ROWS = [
    row("a", "base", 0, 20, 15, 10), row("b", "base", 0, 30, 16, 10),
    row("a", "x.1", 0, 20.5, 14, 20), row("b", "x.1", 0, 30.1, 15, 5),
    row("a", "x.2", 0, 19, 16, 10), row("b", "x.2", 0, 0, 0, 0, "failed"),
    row("a", "y.1", 0, 10, 15.2, 10), row("b", "y.1", 0, 10, 16.4, 40),
]  # fmt: skip


def test_an_alternative_is_compared_with_the_base_at_the_same_place(settle):
    first, second, third = settle.findings(ROWS[::-1], AXES, TABLE, "base")
    assert sorted(first.own) == pytest.approx([0.1, 0.5])
    assert sorted(first.lit) == pytest.approx([-1, -1])
    assert first.cost == pytest.approx((2 * 0.5) ** 0.5)
    assert first.deciding is first.own
    assert (second.own, second.failed) == ((-1.0,), "it broke")
    assert sorted(third.deciding) == pytest.approx([0.2, 0.4])
    assert third.cost == pytest.approx(2)


def test_the_better_half_goes_on_and_what_failed_does_not(settle):
    found = settle.findings(ROWS, AXES, TABLE, "base")
    assert settle.going_on(found) == ["x.1"]
    worse = [settle.Finding(f"z.{i}", {}, (float(v),), (0.0,), 1.0) for i, v in enumerate((-3, 2, -1, 0, 1))]
    assert settle.going_on(worse) == ["z.1", "z.3", "z.4"]


@pytest.mark.parametrize(
    ("values", "gone_on", "expected"),
    [
        ((0.3, 0.4, 0.2, 0.3), True, "better"),
        ((-0.3, -0.4, -0.2, -0.3), True, "worse"),
        ((0.9, -0.7, 0.5, -0.1), True, "no difference"),
        ((0.04, 0.04, 0.04, 0.04), True, "no difference"),
        ((0.3, 0.4), True, "open"),
        ((0.3, 0.4), False, "dropped (n = 2)"),
        ((), True, "not run"),
    ],
)
def test_only_the_last_rung_decides_and_only_beyond_twice_the_standard_error(settle, values, gone_on, expected):
    finding = settle.Finding("x.1", {"fit.w": 1}, values, values, 1.0)
    module = sys.modules["verdict"]
    assert module.decision(finding, 4, gone_on) == expected


def test_the_table_says_how_many_runs_and_which_score_decides(settle):
    found = settle.findings(ROWS, AXES, TABLE, "base")
    lines = settle.markdown(found, 4, ["x.1"]).splitlines()[2:]
    assert lines[0] == ("| x | `fit.w = 1` | 2 | **+0.30 (+0.10 to +0.50)** | -1.00 (-1.00 to -1.00) | × 1.00 | open |")
    assert lines[1] == "| x | `fit.w = 2` | 1 | **-1.00** | +1.00 | × 1.00 | failed |"
    assert "`enhance.eta = 0.1`, `joint = false`, `kind = A`" in lines[2]
    assert "| 2 | -15.00 (-20.00 to -10.00) | **+0.30 (+0.20 to +0.40)** | × 2.00 | dropped (n = 2) |" in lines[2]


def test_rungs_widen_from_one_place_to_the_whole_grid(settle):
    grids = [settle.part(TABLE, rung, ["x.1"])["grid"] for rung in (1, 2, 3)]
    assert grids[0] == {"scene": ["a"], "method": ["base", "naive", "x.1"], "seed": [0]}
    assert grids[1] == {**grids[0], "scene": ["a", "b"]}
    assert grids[2] == {**grids[1], "seed": [0, 1]}


def test_the_study_of_a_rung_is_the_same_study_with_fewer_runs(settle, tmp_path):
    path = next(p for p in STUDIES if p.stem == "choices-bayer")
    table = read_toml(path)
    table["grid"]["method"] = table["grid"]["method"][:5]
    (tmp_path / "rung.toml").write_text(settle.written(settle.part(table, 2, table["grid"]["method"][:4])))
    whole, found = study_of(path, table), study_of(path, read_toml(tmp_path / "rung.toml"))
    wanted = {cell.label: cell.preset for cell in whole.cells}
    assert [wanted[cell.label] for cell in found.cells] == [cell.preset for cell in found.cells]
    assert len(found.cells) == 2 * 2 * 4


@pytest.mark.parametrize("path", [p for p in STUDIES if p.name.startswith("choices")], ids=lambda p: p.stem)
def test_each_alternative_of_a_shipped_study_changes_the_base(settle, path):
    table = read_toml(path)
    names = list(settle.alternatives({**table, "variant": table["variant"]}))
    assert set(names) == {name for name in table["grid"]["method"] if "." in name}
    study = study_of(path, settle.part(table, 1, names))
    configs = {c.preset.methods[0]: c.preset.reconstruct(c.preset.methods[0]).config for c in study.cells}
    assert [name for name in names if configs[name] == configs["base"]] == []


@pytest.mark.parametrize("path", [p for p in STUDIES if p.name.startswith("ablation")], ids=lambda p: p.stem)
def test_each_ablation_leaves_something_out(settle, path):
    table = read_toml(path)
    one = {axis: values[:1] for axis, values in table["grid"].items()}
    study = study_of(path, {**table, "grid": {**one, "method": table["grid"]["method"]}})
    configs = {c.preset.methods[0]: c.preset.reconstruct(c.preset.methods[0]).config for c in study.cells}
    assert [name for name in table["variant"] if name != "base" and configs[name] == configs["base"]] == []


@pytest.mark.parametrize(("missing", "dropped"), [(True, 0), (False, 1)])
def test_nobody_is_dropped_before_all_of_the_rung_have_run(settle, tmp_path, missing, dropped):
    page, folder = tmp_path / "page.md", tmp_path / "out" / "file-rung1"
    page.write_text("<!-- table: file -->\n<!-- /table -->\n")
    (tmp_path / "file.toml").write_text(settle.written(TABLE))
    rows = [r for r in ROWS if r["scene"] == "a" and not (missing and r["method"] == "y.1")]
    folder.mkdir(parents=True)
    (folder / "results.json").write_text(json.dumps({"axes": dict.fromkeys(AXES), "rows": rows}))
    settle.settle([tmp_path / "file.toml"], tmp_path / "out", page, 1, None, True)
    assert page.read_text().count("dropped (n = 1)") == dropped
    assert page.read_text().count("| open |") == 2
    assert page.read_text().count("| not run |") == missing


def test_a_table_replaces_what_stood_in_its_place(settle, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("one\n<!-- table: a -->\nold\n<!-- /table -->\ntwo\n<!-- table: b -->\n<!-- /table -->\n")
    settle.write_table(page, "a", "new\n")
    assert page.read_text() == (
        "one\n<!-- table: a -->\n\nnew\n\n<!-- /table -->\ntwo\n<!-- table: b -->\n<!-- /table -->\n"
    )
    with pytest.raises(ValueError, match="has no <!-- table: c -->"):
        settle.write_table(page, "c", "")
