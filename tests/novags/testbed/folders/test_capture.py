"""What a capture gives of itself."""

from pathlib import Path

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.stages.configs.capturing import CaptureConfig
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

NAMES = ["0000", "0001", "0002"]


@pytest.fixture(scope="module")
def mosaic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs, taken again by a camera with a colour filter array."""
    folder = tmp_path_factory.mktemp("mosaic")
    write_cameras(folder / "photos", NAMES, orbit_rig(3, 32, 24, 50.0, radius=3.0))
    rng = np.random.default_rng(0)
    for name in NAMES:
        write_png(folder / "photos" / "images" / f"{name}.png", rng.integers(20, 250, (24, 32, 3)).astype(np.uint8))
    config = CaptureConfig(sensor="imx900-hcg", electrons=200.0)
    stages.capture(folder / "photos", folder / "capture", config, Console(quiet=True))
    return folder / "capture"


@pytest.mark.parametrize("first", [False, True])
def test_the_clean_exposure_with_errors_of_interpolation_is_another_than_without(mosaic: Path, first: bool) -> None:
    """Rationale: both are kept in memory once they are read, whichever is asked for first."""
    capture, fresh = open_capture(mosaic), open_capture(mosaic)
    found = {kind: capture.clean_linear(1, demosaiced=kind) for kind in (first, not first)}
    assert not np.array_equal(found[False], found[True])
    assert np.array_equal(found[not first], fresh.clean_linear(1, demosaiced=not first))
    assert not np.array_equal(found[True], capture.clean_linear(0, demosaiced=True))


def test_what_others_put_into_a_capture_does_not_make_it_another(mosaic: Path) -> None:
    capture = open_capture(mosaic)
    before = capture.digest()
    (mosaic / "notes.txt").write_text("mine")
    assert capture.digest() == before
    picture = mosaic / "images" / "0001.png"
    kept = picture.read_bytes()
    write_png(picture, np.zeros((24, 32, 3), np.uint8))
    assert capture.digest() != before
    picture.write_bytes(kept)
    assert capture.digest() == before
