"""Some whole commands on projects that are not as they should be. Many more: `python -m tests.fuzz --commands`."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from tests.fuzz.commands.cases import Deeds  # noqa: E402
from tests.fuzz.commands.lines import LINES  # noqa: E402
from tests.fuzz.damage.tree import Tree  # noqa: E402

TRIED = ("list", "score", "score --renders", "report", "plan", "capture of photographs", "characterise")
CASES = 30


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a short run finds, by command; in a process of its own, since it forks."""
    out = tmp_path_factory.mktemp("fuzz")
    words = [sys.executable, "-m", "tests.fuzz", "--commands", "--cases", str(CASES), "--out", str(out)]
    words += [word for name in TRIED for word in ("--reader", name)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    found = [json.loads(file.read_text()) for file in out.glob("*.json")]
    assert len(found) == len(TRIED), done.stdout[-2000:] + done.stderr[-2000:]
    return {record["reader"]: record for record in found}


@pytest.mark.parametrize("name", TRIED)
def test_a_command_works_or_refuses_as_documented(records: dict[str, Any], name: str) -> None:
    record = records[name]
    assert record["cases"] > 0
    told = [f"{f['kind']} {f['place']} {f['detail']}; python -m tests.fuzz --commands --reader {name!r} "
            f"--case {f['case']}" for f in record["findings"]]  # fmt: skip
    assert told == []


def test_cases_of_commands_repeat_and_name_no_place_outside() -> None:
    tree = Tree({"set/set.json": b'{"a": 1}', "exp/naive/run.json": b'{"b": 2}', "scene.xml": b"<scene/>"}, ())
    for line in LINES.values():
        deeds, again = (Deeds(line, tree, 5, ["new/set.json"]) for _ in range(2))
        for k in range(100):
            assert deeds.deed(k) == again.deed(k)
            assert not any(word.startswith("/") or ".." in word for word in deeds.deed(k).words)
