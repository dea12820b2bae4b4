"""What `novags new` writes is what the pages show, and runs as it stands."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest

from novags.commands.new import TRIED, Kind, template
from novags.testbed.study.cells.grid import read_study

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGES = {"method": "adding-a-method", "enhancer": "adding-an-enhancer", "camera": "adding-a-camera-source",
         "scene": "adding-a-scene", "metric": "own-metric", "effect": "adding-a-sensor-effect"}  # fmt: skip
TINY = ("--views", "9", "--width", "24", "--height", "24", "--spp", "4", "--points", "60", "--iterations", "5")


@pytest.mark.parametrize("kind", PAGES)
def test_the_file_is_the_one_of_its_page_with_a_line_that_makes_it_a_plugin(kind: str) -> None:
    page = (DOCS / f"{PAGES[kind]}.md").read_text(encoding="utf-8")
    code = re.findall(r"```python\n(.*?)```", page, flags=re.S)[0]
    assert re.fullmatch(re.escape(code) + r"\nPLUGIN = \{.*\}\n", template(kind))
    assert "this page" not in code
    assert f"`novags new {kind} " in page


def test_every_kind_has_a_file_and_says_how_it_is_tried() -> None:
    assert set(get_args(Kind)) == {*PAGES, "study"} == TRIED.keys()


def test_files_of_all_kinds_work_together(
    tmp_path: Path, call: Callable[..., int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def novags(*words: str, refused: bool = False) -> str:
        done = subprocess.run([sys.executable, "-m", "novags", *words], cwd=tmp_path, capture_output=True, text=True,
                              env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})  # fmt: skip
        assert done.returncode == (2 if refused else 0), done.stderr
        return done.stderr

    monkeypatch.chdir(tmp_path)
    for kind in get_args(Kind):
        assert call("new", kind, f"my-{kind}") == 0
        assert "next: novags " in capsys.readouterr().err
    plugins = [word for kind in PAGES for word in ("--plugin", f"my-{kind}.py")]
    novags("run", *plugins, "--scene", "my-scene", "--methods", "my-method", "my-enhancer-gs", "--cameras",
           "my-camera:step_deg=15", "--sensor", "my-effect.toml", "--out", "out", *TINY)  # fmt: skip
    for method, files in (("my-method", {"my-method.py", "my-camera.py", "my-effect.py"}),
                          ("my-enhancer-gs", {"my-enhancer.py", "my-camera.py", "my-effect.py"})):  # fmt: skip
        versions = json.loads((tmp_path / "out" / method / "run.json").read_text())["stage"]["versions"]
        assert {name for name in versions if name.endswith(".py")} == files
    captured = json.loads((tmp_path / "out" / "capture" / "capture.json").read_text())
    assert captured["stage"]["versions"].keys() >= {"my-effect.py"}
    (glow,) = (effect for effect in captured["plan"]["effects"] if effect["name"] == "my-effect")
    assert glow["on"]
    assert re.match(r"amplifier glow \(from my-effect.py [0-9a-f]{8}\), in the plain chain", glow["reason"])
    scored = json.loads((tmp_path / "out" / "my-method" / "metrics.json").read_text())
    assert scored["stage"]["versions"]["my-metric.py"]
    assert 0 < scored["methods"]["my-method"]["mean"]["lit"]["my-metric"] < 1
    assert "lit.my-metric" in (tmp_path / "out" / "results.csv").read_text().splitlines()[0]
    page = (tmp_path / "out" / "report.html").read_text()
    assert re.search(r"novags reconstruct capture [^&]*--plugin \.\./my-method\.py", page)
    assert "novags score my-method-again --plugin ../my-metric.py" in page
    assert ">MAE<" in (tmp_path / "out" / "report.html").read_text()
    others = [word for k, word in enumerate(plugins) if "my-effect.py" not in plugins[k : k + 2]]
    novags("report", "out", *others)
    page = (tmp_path / "out" / "report.html").read_text()
    assert (
        "no picture that went through it (the camera has an effect &#39;my-effect&#39; that is not known here" in page
    )
    kept = (tmp_path / "out" / "my-method" / "metrics.json").read_bytes()
    assert "effect 'my-effect' that is not known here" in novags("score", "out/my-method", *others, refused=True)
    assert (tmp_path / "out" / "my-method" / "metrics.json").read_bytes() == kept
    assert len(read_study(tmp_path / "my-study.toml").cells) == 18


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("method", "../up"), "letters, digits and . _ + - alone, and begins with one of the first; got '../up'"),
        (("method", "there"), "there.py is there already: choose another name, or move it"),
    ],
)
def test_nothing_is_written_over_or_elsewhere(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("there.py").write_text("mine")
    assert call("new", *words) == 2
    assert said in capsys.readouterr().err
    assert Path("there.py").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["there.py"]
