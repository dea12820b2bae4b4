"""Runs of methods whose enhancer is a network: the file is part of the request, and its copy of the run."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from novags.methods.enhancers.networks.sci import Sci
from novags.methods.variant import parse_variant
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.references import enhanced_dark
from novags.testbed.folders.run import open_run
from novags.testbed.ledger.contents import read_json
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes.sets.pictures.png import read_png

QUIET = Console(quiet=True)
TINY = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 8, "points": 50, "iterations": 4}


def test_a_run_is_scored_with_its_own_copy_of_the_weights(tmp_path: Path) -> None:
    torch.manual_seed(0)
    weights = tmp_path / "sci.pt"
    torch.save(Sci().state_dict(), weights)
    own = parse_variant(f"given=sci-gs:enhance.weights={weights}")
    preset = adapted(EXPERIMENTS["demo"], **TINY, variants=(own,), methods=("given",))
    stages.render(tmp_path / "set", preset.render, QUIET)
    stages.capture(tmp_path / "set", tmp_path / "capture", preset.capture, QUIET)
    config, run = preset.reconstruct("given"), tmp_path / "run"
    record = stages.reconstruct(tmp_path / "capture", run, config, QUIET)
    assert record["found"]["enhancer"]["files"] == ["sci.pt"]
    assert [name for name in record["stage"]["inputs"] if name.endswith("sci.pt")] == ["enhance.weights: sci.pt"]

    torch.save(Sci().state_dict(), weights)  # others under the same name: another request
    with pytest.raises(ValueError, match="another enhance.weights"):
        stages.reconstruct(tmp_path / "capture", run, config, QUIET)
    weights.unlink()
    with pytest.raises(ValueError, match="enhance.weights is .*, but that file does not exist"):
        stages.reconstruct(tmp_path / "capture", tmp_path / "other", config, QUIET)

    shutil.move(run, tmp_path / "moved")
    mean = stages.score(tmp_path / "moved", QUIET)["methods"]["given"]["mean"]
    assert mean["enhanced"]["aligned_psnr"] > 5
    moved = open_run(tmp_path / "moved")
    capture, _ = moved.inputs(QUIET)
    shown = enhanced_dark(capture, 1, moved.enhancement)
    assert np.abs(shown - read_png(moved.path / "enhanced" / "0001.png")).max() <= 0.51 / 255
    assert read_json(moved.path / "run.json")["enhancement"]["config"]["weights"] == ["enhancer.safetensors"]

    (moved.path / "enhancer.safetensors").write_bytes(b"no weights")
    (moved.path / "metrics.json").unlink()
    with pytest.raises(ValueError, match="enhancer.safetensors not as written .*make the run again"):
        stages.score(moved.path, QUIET)
