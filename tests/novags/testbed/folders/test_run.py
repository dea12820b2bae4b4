"""What a run gives of itself."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed.folders.run import RESULT, Run
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import write_png


def test_a_run_that_renders_what_is_no_light_is_refused_with_the_name_of_the_picture(tmp_path: Path) -> None:
    plane = np.full((2, 3), 0.5, np.float32)
    for wrong in (np.nan, np.inf, -np.inf, 1e38):
        for channel in ("R", "Z", "alpha"):
            planes = {name: plane.copy() for name in ("R", "G", "B", "Z", "alpha")}
            planes[channel][1, 2] = wrong
            write_exr(tmp_path / "exr" / "0001.exr", planes)
            with pytest.raises(ValueError, match=rf"0001\.exr is damaged: 1 pixels of its channel {channel} are not"):
                (Run(tmp_path, {}).rendering if channel == "R" else Run(tmp_path, {}).depth)("0001")
    write_exr(tmp_path / "exr" / "0001.exr", {"R": plane, "G": plane})
    with pytest.raises(ValueError, match=r"0001\.exr has no channel B: reconstruct again"):
        Run(tmp_path, {}).rendering("0001")


def test_all_channels_of_a_picture_are_given_in_order(tmp_path: Path) -> None:
    planes = {name: np.full((2, 3), k / 8, np.float32) for k, name in enumerate(("R", "G", "B", "Z", "alpha"))}
    write_exr(tmp_path / "exr" / "0001.exr", planes)
    run = Run(tmp_path, {})
    np.testing.assert_array_equal(run.rendering("0001"), np.stack([planes[name] for name in "RGB"], -1))
    for found, name in zip(run.depth("0001"), ("Z", "alpha"), strict=True):
        np.testing.assert_array_equal(found, planes[name])


@pytest.mark.parametrize("kind", ["renders", "renders_train"])
def test_of_a_run_without_floats_the_picture_of_the_view_is_found_where_it_is(tmp_path: Path, kind: str) -> None:
    codes = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    write_png(tmp_path / kind / "0001.png", codes)
    np.testing.assert_allclose(Run(tmp_path, {}).rendering("0001"), codes / 255, atol=1e-6)
    assert Run(tmp_path, {}).shows("0001")


def test_the_picture_that_is_scored_counts_before_one_that_was_made_for_training(tmp_path: Path) -> None:
    codes = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    write_png(tmp_path / "renders" / "0001.png", codes)
    write_png(tmp_path / "renders_train" / "0001.png", 255 - codes)
    np.testing.assert_allclose(Run(tmp_path, {}).rendering("0001"), codes / 255, atol=1e-6)


@pytest.mark.parametrize("name", RESULT)
def test_every_result_counts_in_the_digest_of_a_run_and_its_scores_do_not(tmp_path: Path, name: str) -> None:
    before = Run(tmp_path, {}).digest()
    for other in ("metrics.json", "report.html", "checkpoint.safetensors", "notes.txt"):
        (tmp_path / other).write_text("x")
    assert Run(tmp_path, {}).digest() == before
    (tmp_path / name).write_text("x")
    assert Run(tmp_path, {}).digest() != before
