"""Claims about what a reconstruction depends on, and where its seed goes; nothing is reconstructed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from novags.methods.enhancers.networks.zero_dce import ZeroDce
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.stages import reconstructing
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

QUIET = Console(quiet=True)


def test_the_seed_reaches_the_camera_source_and_the_problem(capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, seeds, cameras_of = open_capture(capture), list[int](), reconstructing.cameras_of

    def noted(config: Any, capture: Any, source: Any, wanted: Any, points: int, seed: int, *more: Any) -> Any:
        seeds.append(seed)
        return cameras_of(config, capture, source, wanted, points, seed, *more)

    monkeypatch.setattr(reconstructing, "cameras_of", noted)
    config = replace(adapted(EXPERIMENTS["demo"], seed=7).reconstruct("naive"), points=50)
    prepared = reconstructing.prepare(opened, opened.source(QUIET), config, QUIET)
    assert prepared.problem.seed == 7
    assert seeds == [7]


def test_a_run_depends_on_its_capture_its_set_and_the_files_of_its_settings(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was hashed when it was opened is what is hashed again: the same parts, and here the same values."""
    asked: dict[str, Any] = {}

    def stage(*_: Any, **parts: Any) -> Any:
        asked.update(parts)
        raise ValueError("far enough")

    monkeypatch.setattr(reconstructing, "run_stage", stage)
    weights = tmp_path / "w.pth"
    torch.save(ZeroDce().state_dict(), weights)
    preset = adapted(EXPERIMENTS["demo"], methods=("zero-dce-gs",))
    config = replace(preset, settings={"enhance.weights": str(weights)}).reconstruct("zero-dce-gs")
    found = []
    for change in (b"", b"more"):
        weights.write_bytes(weights.read_bytes() + change)
        with pytest.raises(ValueError, match="far enough"):
            stages.reconstruct(capture, tmp_path / "run", config, QUIET)
        assert asked["inputs"]() == asked["opened"]
        found.append(asked["opened"])
    assert found[0].keys() == found[1].keys() > {"capture", "set"}
    assert {name for name in found[0] if found[0][name] != found[1][name]} == found[0].keys() - {"capture", "set"}
