"""Claims about what a page says on how to do it again: of all runs."""

from types import SimpleNamespace
from typing import Any

from novags.testbed.report.blocks.configuration import configuration, failed


def test_all_failed_runs_are_named_with_their_place_and_reason() -> None:
    states = ("skipped", "done", "failed", "failed")
    rows = [{"run": k, "method": "abcd"[k], "state": state, "level": k, "scene": f"s{k}",
             "reason": f"r{k}" if k < 3 else ""}
            for k, state in enumerate(states)]  # fmt: skip
    material: Any = SimpleNamespace(rows=rows, varied=["level", "scene"], unavailable={"lpips": "not installed"})
    found = failed(material, None)  # type: ignore[arg-type]
    assert found == {
        "facts": {"run 0, a, level 0, scene s0": "a task it needs has failed: r0", "run 2, c, level 2, scene s2": "r2",
                  "run 3, d, level 3, scene s3": "no reason is known", "lpips": "not installed"},
        "runs": True, "skipped": True,
    }  # fmt: skip
    material.rows = rows[1:2]
    found = failed(material, None)  # type: ignore[arg-type]
    assert found is not None
    assert (found["runs"], found["skipped"]) == (False, False)


def test_versions_are_of_all_runs_and_of_several_those_of_the_first() -> None:
    versions = ({"torch": "1", "numpy": "2"}, {"torch": "9", "gsplat": "3"}, {"theirs": "4"})
    made = {k: SimpleNamespace(name=f"n{k}", run=SimpleNamespace(record={"stage": {"versions": each}}))
            for k, each in enumerate(versions)}  # fmt: skip
    commands = {0: "novags 0", 1: None, 2: "novags 2"}
    material: Any = SimpleNamespace(made=made, commands=commands, study=None, command=None, one=None)
    found = configuration(material, None)  # type: ignore[arg-type]
    assert found is not None
    assert found["versions"] == {"torch": "1", "numpy": "2", "gsplat": "3", "theirs": "4"}
    assert [line.partition(":")[0] for line in found["commands"]] == ["novags 0", "# n1", "novags 2"]
