"""The example of docs/adding-an-enhancer.md runs, and its parameters reach the noise-free twins."""

import ast
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from novags.methods import METHODS
from novags.methods.enhancers import ENHANCERS
from novags.methods.enhancers.applying import enhanced_twin
from novags.methods.memo import Memo
from novags.methods.variant import parse_variant
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from sensor_model import linear_to_srgb
from sensor_model.files.registry import loaded

PAGE = Path(__file__).resolve().parents[4] / "docs" / "adding-an-enhancer.md"
QUIET = Console(quiet=True)
TINY = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 8, "points": 200, "iterations": 10}


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The page's file as a module, and its two lines in the tables of the project, for the length of a test."""
    code, lines = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    module = ModuleType("novags.methods.enhancers.rows.root")
    exec(compile(code, str(PAGE), "exec"), vars(module))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    rows = ast.literal_eval(f"{{{lines}}}")
    monkeypatch.setitem(ENHANCERS, "root", rows["root"])
    monkeypatch.setitem(METHODS, "root-gs", loaded(rows["root-gs"]))
    return module


def test_the_example_of_the_page_is_an_enhancer(example: ModuleType, tmp_path: Path) -> None:
    soft = parse_variant("soft=root-gs:enhance.exponent=0.8")
    preset = adapted(EXPERIMENTS["demo"], **TINY, variants=(soft,), methods=("root-gs", "soft"))
    stages.render(tmp_path / "set", preset.render, QUIET)
    stages.capture(tmp_path / "set", tmp_path / "capture", preset.capture, QUIET)
    scores = {}
    for name, exponent in (("root-gs", 0.5), ("soft", 0.8)):
        record = stages.reconstruct(tmp_path / "capture", tmp_path / name, preset.reconstruct(name), QUIET)
        assert record["enhancement"]["enhancer"] == "root"
        assert record["enhancement"]["config"] == {"exponent": exponent}
        scores[name] = stages.score(tmp_path / name, QUIET)["methods"][name]["mean"]["enhanced"]["psnr"]
    assert scores["root-gs"] != scores["soft"]


def test_a_noise_free_twin_has_the_white_of_its_noisy_picture(example: ModuleType) -> None:
    light = np.linspace(0.01, 0.1, 75).reshape(5, 5, 3)
    noisy, clean = (torch.from_numpy(linear_to_srgb(part)) for part in (light, light / 2))
    found = enhanced_twin(Memo(), "0001", noisy, clean, example.RootConfig(), "16bit", None)
    expected = linear_to_srgb(np.sqrt(light / 2 / np.quantile(light, 0.99)).clip(0, 1))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-9)
    assert example.middle([0.1, 0.4]) == pytest.approx(0.2)
