"""The example of docs/adding-a-method.md runs, and no part of the test bed asks for more than the contract."""

import ast
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from novags.methods import METHODS, VARIANTS
from novags.methods.reconstruction import Reconstruction
from novags.methods.variant import Method, parse_variant
from novags.splats import Views
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import read_json
from novags.testbed.report.page import write_report
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.place import run
from sensor_model.files.registry import Later
from simscenes import read_exr

PAGE = Path(__file__).resolve().parents[3] / "docs" / "adding-a-method.md"
QUIET = Console(quiet=True)
TINY = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 8, "points": 200, "iterations": 10}


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny")
    tiny = adapted(EXPERIMENTS["demo"], **TINY)
    stages.render(folder / "set", tiny.render, QUIET)
    stages.capture(folder / "set", folder / "capture", tiny.capture, QUIET)
    return folder / "capture"


def example(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's file as a module, and its line in the table, for the length of a test."""
    code, line = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    assert len([line for line in code.splitlines() if line.strip()]) <= 46
    ((name, row),) = ast.literal_eval(f"{{{line}}}").items()
    module = ModuleType(row.partition(":")[0])
    exec(compile(code, str(PAGE), "exec"), vars(module))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(METHODS, name, row)


def test_the_example_of_the_page_is_a_method(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example(monkeypatch)
    method = METHODS["gamma"]
    assert method.parts(method.config()) == {"fit": method.config().fit.iterations}  # budgets count by them
    own = parse_variant("dim=gamma:gamma=0.8")
    preset = adapted(EXPERIMENTS["demo"], **TINY, variants=(own,), methods=("gamma", "dim"))
    records = {
        name: stages.reconstruct(capture, tmp_path / name, preset.reconstruct(name), QUIET) for name in preset.methods
    }
    assert [records[name]["config"]["gamma"] for name in ("gamma", "dim")] == [0.4, 0.8]
    fits = [records[name]["config"]["fit"] for name in ("gamma", "dim")]
    assert [fit["iterations"] for fit in fits] == [10, 10]
    assert [records[name]["eps2d"] for name in ("gamma", "dim")] == [fit["eps2d"] for fit in fits] == [0.1, 0.1]
    scores = {name: stages.score(tmp_path / name, QUIET)["methods"][name]["mean"] for name in preset.methods}
    assert all(mean.keys() == {"lit"} for mean in scores.values())
    assert scores["gamma"] != scores["dim"]


@dataclass(frozen=True, kw_only=True)
class ConstantConfig:
    level: float = 0.25
    space: str = "lit"


@dataclass
class ConstantField:
    """One colour everywhere, at a depth of 2: a scene without Gaussians."""

    color: Tensor

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        shape = (len(views), views.height, views.width)
        return self.color.expand(*shape, 3), torch.ones(shape), torch.full(shape, 2.0)

    def save(self, folder: Path) -> None:
        (folder / "scene").mkdir(exist_ok=True)
        (folder / "scene" / "color.txt").write_text(" ".join(f"{v:.6f}" for v in self.color.tolist()))

    def facts(self) -> dict[str, Any]:
        return {"colors": 1}


def constant(problem: Any, config: ConstantConfig, *, progress: Any = None, checkpoint: Any = None) -> Reconstruction:
    assert problem.clean is None
    assert problem.raw is not None
    assert problem.noise is not None
    return Reconstruction(scene=ConstantField(torch.full((3,), config.level)), space=config.space, config=config)


DUMMY = Method(
    title="one colour", family="NeRF", color="#123456", config=ConstantConfig, train=constant, source="this test"
)


@pytest.mark.parametrize(("space", "kinds"), [("lit", {"lit"}), ("linear", {"linear", "lit"})])
def test_a_method_without_gaussians_goes_through_the_whole_experiment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, space: str, kinds: set[str]
) -> None:
    """Rationale: only `ReconstructedScene` and `Reconstruction` may be assumed; a grid or a mesh is as good."""
    monkeypatch.setitem(METHODS, "constant", replace(DUMMY, config=lambda: ConstantConfig(space=space)))
    preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("constant", "naive", "oracle"))
    page = run(preset, tmp_path, QUIET, report=write_report).read_text(encoding="utf-8")
    record, metrics = read_json(tmp_path / "constant" / "run.json"), read_json(tmp_path / "constant" / "metrics.json")
    assert (record["colors"], record["space"]) == (1, space)
    assert "gaussians" not in record
    assert (tmp_path / "constant" / "scene" / "color.txt").read_text() == "0.250000 0.250000 0.250000"
    assert not (tmp_path / "constant" / "enhanced").exists()
    found = metrics["methods"]["constant"]
    assert found["mean"].keys() == kinds
    assert found["training_2d"] is None
    depth, _ = read_exr(tmp_path / "set" / "gt" / "0000.exr")
    seen = depth["Z"][depth["Z"] < 1e9]
    other, _ = read_exr(tmp_path / "set" / "gt" / "0008.exr")
    errors = [float((abs(2.0 - z) / z).mean()) for z in (seen, other["Z"][other["Z"] < 1e9])]
    assert found["geometry"]["abs_rel"] == pytest.approx(sum(errors) / 2, rel=1e-4)
    assert "Rendered by constant" in page
    assert "#123456" in page


def named_in(path: Path) -> set[str]:
    """The texts in a file but the keys of its dicts: another table or a record may have a key like a method's name."""
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    keys = {id(key) for node in nodes if isinstance(node, ast.Dict) for key in node.keys}
    return {str(node.value) for node in nodes if isinstance(node, ast.Constant) and id(node) not in keys}


def test_no_code_outside_methods_names_one() -> None:
    """METHODS is the one place: code that branches on a name would break for the next method."""
    root, names = Path(__file__).resolve().parents[3] / "novags", {*METHODS, *VARIANTS}
    # presets choose, the command line has a default, a variant says what it varies
    allowed = {"methods/__init__.py", "testbed/study/cells/presets.py", "commands/stages.py"}
    allowed |= {Path(*str(VARIANTS.module_of(name)).split(".")[1:]).as_posix() + ".py" for name in VARIANTS}
    files = [path for path in root.rglob("*.py") if path.relative_to(root).as_posix() not in allowed]
    assert [f"{path.name}: {name}" for path in files for name in sorted(names & named_in(path))] == []


def _module(method: Method) -> str:
    train = method.train
    return train.reference.partition(":")[0] if isinstance(train, Later) else train.__module__


def test_methods_import_no_other_method() -> None:
    root = Path(__file__).resolve().parents[3] / "novags" / "methods"
    modules = {_module(method) for method in METHODS.values()}
    for module in modules:
        file = root.parents[1] / (module.replace(".", "/") + ".py")
        others = [other for other in modules if other != module and other in file.read_text("utf-8")]
        assert others == []
