"""What a capture gives of itself."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as module
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.capture_record import Imported
from novags.testbed.stages.configs.capturing import CaptureConfig
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

NAMES = ["0000", "0001", "0002"]
FOREIGN = Imported(
    parts=("images16", "raw"), levels=(None, 64.0, 1023.0), depth="raw", lit=None, clean=None, dataset=None, split=None
)  # fmt: skip


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


@pytest.mark.parametrize("what", ["srgb8", "linear16", "clean_linear", "clean"])
def test_each_view_that_is_kept_in_memory_is_kept_by_itself(mosaic: Path, what: str) -> None:
    together = open_capture(mosaic)
    for i in (0, 1, 2, 0):
        alone = replace(together, memo=type(together.memo)())
        np.testing.assert_array_equal(getattr(together, what)(i), getattr(alone, what)(i))
    found = [getattr(together, kind)(i).tobytes() for kind in ("srgb8", "linear16", "clean_linear") for i in range(3)]
    assert len(set(found)) == 9


@pytest.mark.parametrize("lacking", NAMES)
def test_every_view_but_those_without_a_measured_depth_has_its_own(mosaic: Path, lacking: str) -> None:
    capture = open_capture(mosaic)
    told = replace(FOREIGN, parts=("lit", "depth"), unscanned=(lacking,))
    other = replace(capture, record=replace(capture.record, simulated=None, imported=told))
    wanted = {i: mosaic / "depth" / f"{name}.exr" for i, name in enumerate(NAMES) if name != lacking}
    assert other.source(Console(quiet=True)).scanned == wanted


@pytest.mark.parametrize("foreign", [False, True])
def test_the_noise_of_pictures_is_estimated_with_the_levels_of_their_raw_frames(
    mosaic: Path, monkeypatch: pytest.MonkeyPatch, foreign: bool
) -> None:
    capture = open_capture(mosaic)
    asked = dict[str, Any]()

    def noise_from(srgb8: Any, linear16: Any, raw: Any, *, mixed: bool) -> None:
        asked.update(srgb8=srgb8, linear16=linear16, raw=raw)

    monkeypatch.setattr(module, "PHOTOGRAPHS", {"noise": noise_from})
    monkeypatch.setattr(module, "SMALLEST", 8)
    changes: dict[str, Any] = {"imported": FOREIGN, "sensor": None} if foreign else {"resampled": {}}
    other = replace(capture, record=replace(capture.record, **changes), memo=type(capture.memo)())
    assert other.noise is None
    cfa, black, white = (None, 64.0, 1023.0) if foreign else ("RGGB", *other.levels[1:])
    assert black < white
    assert (asked["raw"].cfa, asked["raw"].black, asked["raw"].white) == (cfa, black, white)
    for kind, read in (("srgb8", other.srgb8), ("linear16", other.linear16)):
        np.testing.assert_array_equal(asked[kind], [read(i) for i in other.cameras.train_indices])
    np.testing.assert_array_equal(asked["raw"].dn, [other.raw(i) for i in other.cameras.train_indices])


@pytest.mark.parametrize(("levels", "reasons"), [((None, 64.0, 1023.0), ()), (("RGGB", 0.0, 1.0), ("demosaicing",)),
                                                 (None, ("demosaicing",))])  # fmt: skip
def test_pixels_share_noise_where_a_filter_array_is_stated_or_nothing_is(
    mosaic: Path, levels: Any, reasons: tuple[str, ...]
) -> None:
    capture = open_capture(mosaic)
    record = replace(capture.record, sensor=None, imported=replace(FOREIGN, levels=levels), color_matrix=None)
    assert replace(capture, record=record).channels_share == reasons


def test_photographs_from_elsewhere_are_their_own_set_with_all_views(mosaic: Path) -> None:
    capture = open_capture(mosaic)
    for parts, kind in ((("images16",), "images"), (("images16", "lit"), "lit")):
        record = replace(capture.record, simulated=None, imported=replace(FOREIGN, parts=parts))
        source = replace(capture, record=record).source(Console(quiet=True))
        assert source.views.files == tuple(mosaic / kind / f"{name}.png" for name in NAMES)
        assert source.lit_known == (kind == "lit")


def test_what_others_put_into_a_capture_does_not_make_it_another(mosaic: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = open_capture(mosaic)
    before = capture.digest()
    (mosaic / "notes.txt").write_text("mine")
    assert capture.digest() == before
    monkeypatch.setattr(module, "_OPENED", {})
    assert open_capture(mosaic).content == before
    picture = mosaic / "images" / "0001.png"
    kept = picture.read_bytes()
    write_png(picture, np.zeros((24, 32, 3), np.uint8))
    assert capture.digest() != before
    picture.write_bytes(kept)
    assert capture.digest() == before
