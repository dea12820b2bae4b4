"""Claims about a whole experiment in one folder: what is refused before any work."""

from dataclasses import replace
from pathlib import Path

import pytest

from novags.methods.variant import Variant
from novags.testbed.console import Console
from novags.testbed.experiment import run
from novags.testbed.presets import EXPERIMENTS

QUIET = Console(quiet=True)


@pytest.mark.parametrize("name", ["set", "capture", "report.html"])
def test_a_variant_is_not_called_as_something_else_in_the_folder_of_an_experiment(tmp_path: Path, name: str) -> None:
    """Rationale: after the render and the capture its run was refused, or written into the set."""
    preset = replace(EXPERIMENTS["demo"], methods=(name,), variants=(Variant(name=name, method="naive"),))
    with pytest.raises(ValueError, match=f"a variant must not be called {name}"):
        run(preset, tmp_path / "out", QUIET)
    assert not (tmp_path / "out").exists()


def test_a_name_that_no_folder_can_have_is_refused_at_once() -> None:
    """Rationale: the file system refused it after the render and the capture."""
    Variant(name="a" * 100, method="naive")
    with pytest.raises(ValueError, match=r"must be letters.*, at most 100, .* got 'aaa"):
        Variant(name="a" * 300, method="naive")
