"""Claims about whose the checkpoints of a run of several fits are."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from novags.methods.noise import Variance
from novags.methods.nova_plus.checkpoints import OWNER, claim, run_identity
from novags.methods.nova_plus.config import NovaPlusConfig
from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.problem import Problem
from novags.splats import Views
from sensor_model import NoiseCurve

CONFIG = NovaPlusConfig()
NEVER = (float("inf"),) * 3
CURVE = NoiseCurve(
    black=(0.0,) * 3, white=(1.0,) * 3, offset=(1e-4,) * 3, slope=(1e-3,) * 3, quadratic=(0.0,) * 3, switch=NEVER,
    step=(0.0,) * 3,
)  # fmt: skip


def start(**changes: Any) -> Any:
    return SimpleNamespace(**({"points": torch.zeros(4, 3), "colors": torch.ones(4, 3), "extent": 1.0} | changes))


PROBLEM = Problem(
    views=Views(torch.eye(4).repeat(2, 1, 1), torch.eye(3).repeat(2, 1, 1), 4, 3), start=start(), seed=1,
    srgb8=torch.full((2, 3, 4, 3), 0.5),
)  # fmt: skip
DATA = LightMeasurements(
    light=torch.full((2, 3, 4, 3), 0.2), noise=Variance(CURVE), white=torch.ones(3), matrix=None,
    held=torch.zeros(2, 3, 4, dtype=torch.bool),
)  # fmt: skip


def moved(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor with its last number changed."""
    found = tensor.clone()
    found.view(-1)[-1] = not found.view(-1)[-1] if found.dtype == torch.bool else found.view(-1)[-1] + 0.25
    return found


def others() -> Iterator[tuple[str, Problem, NovaPlusConfig, LightMeasurements]]:
    views = PROBLEM.views
    problems = {
        "viewmats": replace(PROBLEM, views=replace(views, viewmats=moved(views.viewmats))),
        "Ks": replace(PROBLEM, views=replace(views, Ks=moved(views.Ks))),
        "pictures": replace(PROBLEM, srgb8=moved(PROBLEM.srgb8)),
        "points": replace(PROBLEM, start=start(points=moved(PROBLEM.start.points))),
        "colours": replace(PROBLEM, start=start(colors=moved(PROBLEM.start.colors))),
        "seed": replace(PROBLEM, seed=2),
    }
    yield from ((name, problem, CONFIG, DATA) for name, problem in problems.items())
    data = {
        "light": replace(DATA, light=moved(DATA.light)),
        "held": replace(DATA, held=moved(DATA.held)),
        "noise": replace(DATA, noise=Variance(replace(CURVE, slope=(1e-3, 1e-3, 2e-3)))),
    }
    yield from ((name, PROBLEM, CONFIG, measured) for name, measured in data.items())
    yield "settings", PROBLEM, replace(CONFIG, fit=replace(CONFIG.fit, iterations=7)), DATA


@pytest.mark.parametrize(("what", "problem", "config", "data"), list(others()), ids=[name for name, *_ in others()])
def test_a_run_is_another_one_with_any_other_input(
    what: str, problem: Problem, config: NovaPlusConfig, data: LightMeasurements, tmp_path: Path
) -> None:
    own = run_identity(PROBLEM, CONFIG, DATA)
    assert own == run_identity(PROBLEM, CONFIG, DATA)
    claim(tmp_path / "run", own)
    (tmp_path / "run" / "first.safetensors").write_bytes(b"")
    claim(tmp_path / "run", own)
    with pytest.raises(ValueError, match="belongs to a run of other pictures or settings"):
        claim(tmp_path / "run", run_identity(problem, config, data))


def test_checkpoints_without_an_owner_are_nobodys(tmp_path: Path) -> None:
    claim(tmp_path / "run", "a")
    claim(tmp_path / "run", "b")  # there is no checkpoint yet
    (tmp_path / "run" / "first.safetensors").write_bytes(b"")
    (tmp_path / "run" / OWNER).unlink()
    with pytest.raises(ValueError, match="belongs to a run"):
        claim(tmp_path / "run", "b")
