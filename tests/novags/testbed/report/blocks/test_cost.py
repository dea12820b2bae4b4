"""Claims about the cost: stages of all runs, and what is said of runs that were not made alike."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report.blocks import cost
from novags.testbed.report.blocks.cost import costs, mixed, speed


def run(processor: str = "P", gpu: str | None = None, **versions: str) -> Any:
    hardware = {"processor": processor, "gpu": gpu, "cores": 2, "memory_bytes": 1}
    versions = {"python": "3.11.2", "torch": "2.13.0", **versions}
    return SimpleNamespace(record={"stage": {"versions": versions, "hardware": hardware}})


def test_runs_that_were_made_alike_need_no_word() -> None:
    assert mixed({"naive": run(), "oracle": run()}) == ""
    assert mixed({"naive": run()}) == ""


def test_what_differs_is_named_with_the_runs_that_have_it() -> None:
    said = mixed({"naive": run(), "oracle": run(torch="2.14.0"), "nova": run("Q", "H100", gsplat="1.5")})
    assert "torch 2.13.0 (naive, nova), 2.14.0 (oracle)" in said
    assert "processor P (naive, oracle), Q (nova)" in said
    assert "GPU none (naive, oracle), H100 (nova)" in said
    assert "gsplat 1.5 (nova), not installed (naive, oracle)" in said
    assert "python" not in said


def test_a_package_whose_rows_only_some_runs_use_makes_no_difference() -> None:
    theirs = {"naive": run(), "theirs": run(**{"their-package": "1.2"}), "mine": run(**{"mine.py": "59460794"})}
    assert mixed(theirs) == ""
    assert "their-package 1.2 (theirs), 1.3 (new)" in mixed({**theirs, "new": run(**{"their-package": "1.3"})})


def test_of_many_runs_a_few_are_named() -> None:
    runs = {f"run {i}": run() for i in range(9)} | {"other": run(torch="2.14.0")}
    assert "2.13.0 (run 0, run 1, run 2 and 6 more), 2.14.0 (other)" in mixed(runs)


@pytest.mark.parametrize("counts", [(1, 1), (1, 3), (2, 1)])
def test_every_stage_has_a_row_and_any_that_was_done_often_a_count(
    counts: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [{"label": f"stage {i}", "count": count, "seconds": 3.0, "peak": 1e6, "parts": {}, "look": "", "bar": 1.0,
             "share": 0.5} for i, count in enumerate(counts)]  # fmt: skip
    monkeypatch.setattr(cost, "costs", lambda _: rows)
    monkeypatch.setattr(cost, "mixed", lambda _: [])
    run = SimpleNamespace(name="a", run=SimpleNamespace(record={"stage": {"hardware": {}}}))
    material: Any = SimpleNamespace(made={1: run}, one=None, rows=[])
    found = cost.cost(material, None)  # type: ignore[arg-type]
    assert found is not None
    assert [row.cells[0] for row in found["table"].rows] == [row["label"] for row in rows]
    assert len(found["table"].columns) == (6 if max(counts) > 1 else 4)
    assert found["shared"] == (max(counts) > 1)


def of(folder: Path, name: str, capture: str, seconds: float, of_set: str = "set", **more: Any) -> Any:
    """The records of a run, of its capture and of its set."""
    parts = {"fit": seconds / 2, "denoise": seconds / 4}
    record = {"stage": {"seconds": seconds, "peak_bytes": 1}, "seconds": parts}
    (folder / name).mkdir()
    (folder / name / "metrics.json").write_text(json.dumps({"stage": {"seconds": 0.5, "peak_bytes": 9}}))
    made = SimpleNamespace(
        path=folder / name, record=record, peak_bytes=int(100 * seconds), name=name.partition("-")[0]
    )
    captured, rendered = {"stage": {"seconds": 3.0, "peak_bytes": 5}}, {"stage": {"seconds": 7.0, "peak_bytes": 6}}
    return SimpleNamespace(
        run=made, name=name, capture=Path(capture), set=Path(of_set), captured=captured | more, rendered=rendered
    )


def test_every_stage_of_every_run_counts_and_what_is_shared_counts_once(tmp_path: Path) -> None:
    made = {1: of(tmp_path, "a-1", "c1", 8.0, "other"), 2: of(tmp_path, "b-1", "c2", 16.0),
            3: of(tmp_path, "a-2", "c2", 32.0), 4: of(tmp_path, "b-2", "c3", 4.0, kind="imported")}  # fmt: skip
    looks = {"a": SimpleNamespace(key="key-a"), "b": SimpleNamespace(key="key-b")}
    material: Any = SimpleNamespace(made=made, looks=looks, study=None, called=lambda each: each.run.name)
    found = {row["label"]: row for row in costs(material)}
    assert {label: (row["count"], row["seconds"], row["peak"]) for label, row in found.items()} == {
        "render": (2, 14.0, 6), "capture": (2, 6.0, 5), "import": (1, 3.0, 5), "reconstruct: a": (2, 40.0, 3200),
        "reconstruct: b": (2, 20.0, 1600), "score": (1, 2.0, 9),
    }  # fmt: skip
    assert found["reconstruct: a"]["parts"] == {"fit": 20.0, "denoise": 10.0}
    assert [found[f"reconstruct: {name}"]["look"] for name in "ab"] == ["key-a", "key-b"]
    assert sum(row["share"] for row in found.values()) == pytest.approx(1)
    assert {label: row["bar"] for label, row in found.items() if row["bar"] == 1} == {"reconstruct: a": 1.0}
    material.study = ("folder", {})
    assert "score" not in {row["label"] for row in costs(material)}


def drawn(method: str, slow: float, **more: Any) -> dict[str, Any]:
    rates = {"160": 10 * slow, "800": slow, "device": "cpu", "threads": 2, **more}
    return {"method": method, **{f"frames_per_second.{name}": value for name, value in rates.items()}}


def test_the_rate_of_a_method_is_the_mean_over_its_runs_with_what_drew_them() -> None:
    rows = [drawn("a", 2.0), drawn("a", 4.0, threads=1), drawn("b", 50.0, device="cuda"), {"method": "nerf"}]
    table = speed(SimpleNamespace(rows=rows))  # type: ignore[arg-type]
    assert table is not None
    shown = [[cell if isinstance(cell, str) else cell.text for cell in row.cells] for row in table.rows]
    assert shown == [["a", "30", "3.0", "2 threads, 1 thread"], ["b", "500", "50", "GPU"]]


def test_runs_that_were_never_timed_make_no_table() -> None:
    rows = [{"method": "nerf"}, {"method": "a", "frames_per_second.160": None, "frames_per_second.800": 3.0}]
    assert speed(SimpleNamespace(rows=rows)) is None  # type: ignore[arg-type]
