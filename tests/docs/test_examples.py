"""Examples of README and docs/ that are marked as such run as they stand, a page in one folder and in order."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.folders.runs import runs_in  # noqa: E402
from sensor_model import read_sensor, srgb_to_linear  # noqa: E402
from simscenes.sets.pictures.exr import write_exr  # noqa: E402
from tests.fuzz.readers.records import make_run  # noqa: E402

EXAMPLE = re.compile(r"^<!-- run -->\n```python\n(.*?)^```$", re.M | re.S)
PRINTED = {  # what the last lines of a page's examples say, where that is worth a claim
    "README.md": r"uint16 \(64, 64, 3\) 1\.0\n",
    "own-camera.md": r"\d+ electrons",
    "own-metric.md": r"naive 0\.00\d{2}\noracle 0\.[1-9]\d{3}",
    "in-python.md": r"\(32, 32, 3\) .* \[0, 8\]\nuint16 1\.0 .*'photon_shot'.*\(1, 32, 32, 3\) True\n"
    r"4000 0\.\d+\n.*0000.*0\.\d{4}\n",
    "recipes.md": r"\['naive', 'oracle'\] .*tabular.*oracle & naive & -?\d\.\d+ & .*0001 \[.*\n0\.5\n0\.\d+\n"
    r"median \d+%\nTrue\nTrue .*20 e-: \d\d\.\d dB\n5 e-: \d\d\.\d dB\n",
}


def examples(page: Path) -> list[str]:
    return EXAMPLE.findall(page.read_text(encoding="utf-8"))


WITH_EXAMPLES = [page for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) if examples(page)]


def test_there_are_examples_and_all_are_short() -> None:
    assert {page.name for page in WITH_EXAMPLES} == set(PRINTED)
    found = [example for page in WITH_EXAMPLES for example in examples(page)]
    assert len(found) >= 8
    assert max(len([line for line in example.splitlines() if line.strip()]) for example in found) <= 13


def test_the_camera_of_the_page_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "own-camera.md").read_text(encoding="utf-8")
    (block,) = re.findall(r'^```toml title="mine.toml"\n(.*?)^```$', text, re.M | re.S)
    (tmp_path / "mine.toml").write_text(block, encoding="utf-8")
    sensor = read_sensor(tmp_path / "mine.toml")
    assert (sensor.gain, sensor.sigma_d, sensor.mu_e_sat, sensor.cfa) == (2.5, 1.8, 12000, "RGGB")
    for name in [line.split(" = ")[0] for line in block.splitlines()][:5]:
        (tmp_path / "mine.toml").write_text(re.sub(rf"^{name} .*$", "", block, flags=re.M), encoding="utf-8")
        with pytest.raises(ValueError, match=f"{name} missing"):
            read_sensor(tmp_path / "mine.toml")


def ends_in_the_light_of_the_scene(folder: Path) -> None:
    """Make a run one that renders the truth in linear light, as dark as the capture: `lit` is 20 times as bright."""
    (run,) = runs_in([folder]).values()
    capture, lit = run.inputs(Console(quiet=True))
    for i, name in enumerate(capture.names):
        light = (srgb_to_linear(lit.lit(i)) / 20).astype(np.float32)
        write_exr(folder / "exr" / f"{name}.exr", {channel: light[..., k] for k, channel in enumerate("RGB")})
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"space": "linear", "enhancement": None}))


@pytest.mark.parametrize("page", WITH_EXAMPLES, ids=lambda page: page.name)
def test_the_examples_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    if page.name == "own-metric.md":
        (tmp_path / "experiment").mkdir()
        make_run(tmp_path / "experiment")
        ends_in_the_light_of_the_scene(tmp_path / "experiment" / "naive")
    space: dict[str, object] = {}
    for number, example in enumerate(examples(page), 1):
        exec(compile(example, f"{page.name}, example {number}", "exec"), space)
    assert re.search(PRINTED[page.name], capsys.readouterr().out, re.S)
