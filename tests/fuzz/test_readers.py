"""Some hundred damaged files for every reader. Many more: `python -m tests.fuzz`, see docs/fuzz.md."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from tests.fuzz.readers import READERS  # noqa: E402
from tests.fuzz.readers.scenes import bare, places, plugins  # noqa: E402

CASES = 1200


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a short run finds, by reader; in a process of its own, since it forks."""
    out = tmp_path_factory.mktemp("fuzz")
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--cases", str(CASES), "--out", str(out)],
        cwd=ROOT, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    found = [json.loads(file.read_text()) for file in out.glob("*.json")]
    assert len(found) == len(READERS), done.stdout[-2000:] + done.stderr[-2000:]
    return {record["reader"]: record for record in found}


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused_as_documented(records: dict[str, Any], name: str) -> None:
    record = records[name]
    assert record["cases"] >= 5
    told = [f"{f['kind']} {f['place']} {f['detail']}; python -m tests.fuzz --reader {name!r} --case {f['case']}"
            for f in record["findings"]]  # fmt: skip
    assert told == []


def test_every_plugin_of_mitsuba_is_tried_bare_in_every_place() -> None:
    assert len(plugins()) > 90
    assert {"bitmap", "merge", "blendbsdf", "hair"} <= set(plugins())
    tags = {tag for tag, _ in places("x")}
    assert {"shape", "bsdf", "texture", "emitter", "sensor", "film", "integrator", "medium", "phase", "volume"} <= tags
    assert len(bare()) == len(plugins()) * len(places("x"))
    assert len({name for name, _ in bare()}) == len(bare())
