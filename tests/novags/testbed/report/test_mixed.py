"""Claims about what a comparison says of runs that were not made alike."""

from types import SimpleNamespace
from typing import Any

from novags.testbed.report.blocks.cost import mixed


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
