"""Claims about a whole experiment in one folder: what is refused before any work."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from novags.methods.variant import Variant
from novags.testbed import experiment, stages
from novags.testbed.console import Console
from novags.testbed.presets import EXPERIMENTS
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)


@pytest.mark.parametrize("name", ["set", "capture", "report.html"])
def test_a_variant_is_not_called_as_something_else_in_the_folder_of_an_experiment(tmp_path: Path, name: str) -> None:
    """Rationale: after the render and the capture its run was refused, or written into the set."""
    preset = replace(EXPERIMENTS["demo"], methods=(name,), variants=(Variant(name=name, method="naive"),))
    with pytest.raises(ValueError, match=f"a variant must not be called {name}"):
        experiment.run(preset, tmp_path / "out", QUIET)
    assert not (tmp_path / "out").exists()


def test_a_name_that_no_folder_can_have_is_refused_at_once() -> None:
    """Rationale: the file system refused it after the render and the capture."""
    Variant(name="a" * 100, method="naive")
    with pytest.raises(ValueError, match=r"must be letters.*, at most 100, .* got 'aaa"):
        Variant(name="a" * 300, method="naive")


def test_a_capture_of_a_given_set_is_refused_before_another_set_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: who left out --scene SET waited for a render, and was refused after it."""
    views, rng = tmp_path / "views", np.random.default_rng(0)
    names = [f"{i:04d}" for i in range(3)]
    write_cameras(views, names, orbit_rig(3, 24, 24, 50.0, radius=3.0))
    for name in names:
        write_png(views / "images" / f"{name}.png", rng.integers(20, 250, (24, 24, 3)).astype(np.uint8))
    preset = EXPERIMENTS["demo"]
    stages.capture(views, tmp_path / "out" / "capture", preset.capture, QUIET, for_runs=True)
    monkeypatch.setattr(experiment, "make_set", lambda *_, **__: pytest.fail("rendered"))
    with pytest.raises(ValueError, match=r"is a finished capture of the set .*views, which this request does not name"):
        experiment.run(preset, tmp_path / "out", QUIET)
