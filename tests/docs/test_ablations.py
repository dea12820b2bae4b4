"""The tables of docs/ablations.md against numbers worked out by hand."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts" / "choices"
AXES = {"scene": ["a", "b"], "level": ["dim", "dark"], "method": ["base", "less", "other"], "seed": [0]}


@pytest.fixture(scope="module")
def ablations(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("choices/ablations.py")


def row(scene: str, level: str, method: str, own: float | None, lit: float, state: str = "done") -> dict[str, Any]:
    more = {
        "enhanced.aligned_ssim": 0.5, "enhanced.flip": 0.25, "enhanced.delta_e": 3.0, "geometry.abs_rel": 0.125,
        "geometry.floaters": None, "geometry.consistency.excess": 0.01, "noise.targets": 0.5, "noise.renders": 0.25,
        "noise.bias_floor": 20.0, "seconds.reconstruct": own,
    }  # fmt: skip
    return {"scene": scene, "level": level, "method": method, "seed": 0, "state": state,
            "enhanced.aligned_psnr": own, "lit.tone_aligned_psnr": lit, **more}  # fmt: skip


ROWS = [
    row("a", "dim", "base", 20, 15), row("b", "dim", "base", 30, 16), row("a", "dark", "base", 10, 9),
    row("a", "dim", "less", 21, 14), row("b", "dim", "less", 32, 13), row("a", "dark", "less", 9.5, 9),
    row("b", "dark", "less", 50, 50), row("a", "dim", "other", 60, 15.5), row("b", "dim", "other", 0, 0, "failed"),
]  # fmt: skip


def test_a_method_is_compared_with_the_base_at_the_same_place_and_level(ablations: ModuleType) -> None:
    lines = ablations.differences(ROWS, AXES, "enhanced.aligned_psnr", ["other"]).splitlines()
    assert lines[0] == "| level | dim | dark |"
    assert lines[2] == "| `base` | 25.00 dB | 10.00 dB |"
    assert lines[3] == "| `less` | +1.50 ± 0.50 | -0.50 |"  # nothing to compare the run of scene b in the dark with
    assert lines[4] == "| `other` | – | – |"
    lit = ablations.differences(ROWS, AXES, "lit.tone_aligned_psnr", []).splitlines()
    assert lit[3] == "| `less` | -2.00 ± 1.00 | +0.00 |"
    assert lit[4] == "| `other` | +0.50 | – |"


def test_means_leave_out_what_is_not_known_or_not_comparable(ablations: ModuleType) -> None:
    head, _, base, less, other = ablations.means(ROWS, ["other"]).splitlines()
    assert head.count("|") == base.count("|")
    assert base == "| `base` | 0.500 | 0.250 | 3.0 | 12.5 | – | 0.010 | 0.50 | 0.25 | 20.0 | 20 |"
    assert less.endswith("| 28 |")
    assert other == "| `other` | – | – | – | 12.5 | – | 0.010 | – | – | – | 60 |"


def test_the_columns_are_those_of_the_last_axis_that_is_a_place(ablations: ModuleType) -> None:
    assert ablations.columns_of(ROWS, ["scene", "level", "method", "seed"]) == ("level", ["dim", "dark"])
    assert ablations.columns_of(ROWS, ["scene", "method", "seed"]) == ("scene", ["a", "b"])


def test_the_page_says_how_many_runs_there_are(
    ablations: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, page = tmp_path / "study", tmp_path / "page.md"
    folder.mkdir()
    (folder / "results.json").write_text(json.dumps({"axes": AXES, "rows": ROWS}))
    page.write_text("<!-- table: study -->\n<!-- /table -->\n")
    monkeypatch.setattr(sys, "argv", ["ablations.py", str(folder), "--page", str(page)])
    ablations.main()
    assert "8 of 9 runs." in page.read_text()
    assert page.read_text().count("| `less` |") == 3
