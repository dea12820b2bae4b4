"""The examples of docs/ that are marked as such run as they stand, those of a page in one folder and in their order."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from sensor_model import read_sensor  # noqa: E402
from tests.fuzz.readers.records import make_run  # noqa: E402

EXAMPLE = re.compile(r"^<!-- run -->\n```python\n(.*?)^```$", re.M | re.S)
PRINTED = {  # what the last lines of a page's examples say, where that is worth a claim
    "own-camera.md": r"\d+ electrons",
    "own-metric.md": r"naive 0\.\d{4}\noracle 0\.\d{4}",
    "in-python.md": r"\(32, 32, 3\) .* \[0, 8\]\nuint16 1\.0 .*'photon_shot'.*\(1, 32, 32, 3\) True\n"
    r"4000 0\.\d+\n.*0000.*0\.\d{4}\n",
}


def examples(page: Path) -> list[str]:
    return EXAMPLE.findall(page.read_text(encoding="utf-8"))


WITH_EXAMPLES = [page for page in sorted((ROOT / "docs").glob("*.md")) if examples(page)]


def test_there_are_examples_and_all_are_short() -> None:
    assert {page.name for page in WITH_EXAMPLES} == set(PRINTED)
    found = [example for page in WITH_EXAMPLES for example in examples(page)]
    assert len(found) >= 8
    assert max(len([line for line in example.splitlines() if line.strip()]) for example in found) <= 11


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


@pytest.mark.parametrize("page", WITH_EXAMPLES, ids=lambda page: page.name)
def test_the_examples_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    if page.name == "own-metric.md":
        (tmp_path / "experiment").mkdir()
        make_run(tmp_path / "experiment")
    space: dict[str, object] = {}
    for number, example in enumerate(examples(page), 1):
        exec(compile(example, f"{page.name}, example {number}", "exec"), space)
    assert re.search(PRINTED[page.name], capsys.readouterr().out, re.S)
