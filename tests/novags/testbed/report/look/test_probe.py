"""Claims about the numbers under the probe: they are those of the files."""

import math
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from novags.testbed.folders.capture import Capture
from novags.testbed.report.look.probe import probe_of
from sensor_model.isp import white_balance
from simscenes.sets.pictures.exr import read_exr


def planes(header: dict[str, Any], data: bytes) -> dict[str, np.ndarray]:
    """Each plane [channels,h,w] by its name, as the page describes them."""
    raw, start, found = np.frombuffer(zlib.decompress(data), np.uint8), 0, {}
    for plane in header["planes"]:
        shape = (plane["channels"], header["height"], header["width"])
        count = math.prod(shape)
        low, high = raw[start : start + count], raw[start + count : start + 2 * count]
        codes = low.astype(np.uint16) + 256 * high.astype(np.uint16)
        values = codes if plane["whole"] else codes.view(np.float16).astype(float) * plane["scale"]
        found[plane["name"]] = values.reshape(shape)
        start += 2 * count
    assert start == len(raw)
    if header["floor"] is not None:
        found["noise"] = np.sqrt(found["mean"] + header["floor"])
    return found


@pytest.mark.parametrize("name", ["chips", "mosaic"])
def test_a_probe_holds_what_the_files_of_the_capture_say(captures: dict[str, Capture], name: str) -> None:
    capture = captures[name]
    sensor = capture.sensor
    assert sensor is not None
    probe = probe_of(capture, 1)
    assert probe is not None
    found = planes(probe.header, probe.data)
    truth, _ = read_exr(capture.path / "truth" / "0001.exr")
    mean, variance = (
        np.stack([truth[f"{kind}.{c}"] for c in "RGB"]) if name == "chips" else truth[kind][None]
        for kind in ("mean", "variance")
    )
    raw = capture.raw(1)
    assert (found["dn"] == (np.moveaxis(raw, -1, 0) if raw.ndim == 3 else raw[None])).all()
    assert found["mean"] == pytest.approx((mean - sensor.black_level) / sensor.gain, rel=6e-4, abs=1e-6)
    assert found["noise"] == pytest.approx(np.sqrt(variance) / sensor.gain, rel=6e-4)
    assert probe.header["per_dn"] is None  # a colour matrix mixes the channels
    assert np.moveaxis(found["linear"], 0, -1) == pytest.approx(capture.linear16(1), rel=6e-4, abs=1e-7)
    assert np.moveaxis(found["linear_mean"], 0, -1) == pytest.approx(capture.clean_linear(1), rel=6e-4, abs=1e-7)
    assert probe.header["cfa"] == sensor.cfa


def test_noise_that_the_mean_does_not_give_has_numbers_of_its_own(
    captures: dict[str, Capture], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photon noise is the root of the mean and of a floor: that is one number; a pattern of its own is not."""
    capture = captures["chips"]
    assert capture.sensor is not None
    plain = probe_of(capture, 1)
    mean = capture.truth(1, "mean")
    rows = np.arange(24, dtype=np.float32)[:, None, None]
    truths = {"mean": mean, "clean": mean, "variance": mean + rows}
    monkeypatch.setattr(type(capture), "truth", lambda self, i, kind: truths[kind])
    probe = probe_of(capture, 1)
    assert probe is not None
    assert plain is not None
    assert (plain.header["floor"] is not None, probe.header["floor"]) == (True, None)
    noise = planes(probe.header, probe.data)["noise"]
    assert np.moveaxis(noise, 0, -1) == pytest.approx(np.sqrt(mean + rows) / capture.sensor.gain, rel=6e-4)
    assert len(plain.data) < len(probe.data)


def test_signals_beyond_half_precision_keep_their_scale(captures: dict[str, Capture], monkeypatch: Any) -> None:
    capture = captures["chips"]
    bright = np.full((24, 32, 3), 5e6, np.float32)
    bright[0, 0] = 2e5
    monkeypatch.setattr(type(capture), "truth", lambda self, i, kind: bright)
    probe = probe_of(capture, 0)
    assert probe is not None
    mean = planes(probe.header, probe.data)["mean"]
    assert capture.sensor is not None
    assert mean[0, 1, 1] == pytest.approx((5e6 - 512) / capture.sensor.gain, rel=1e-3)
    assert mean[0, 0, 0] == pytest.approx((2e5 - 512) / capture.sensor.gain, rel=1e-3)


def test_light_without_a_colour_matrix_is_a_multiple_of_the_codes_above_black(captures: dict[str, Capture]) -> None:
    capture = captures["chips"]
    plain = replace(capture, record=replace(capture.record, color_matrix=None), memo=type(capture.memo)())
    probe = probe_of(plain, 1)
    assert probe is not None
    assert plain.sensor is not None
    _, black, white = plain.levels
    assert (probe.header["black"], probe.header["white"]) == (black, white)
    assert probe.header["per_dn"] == pytest.approx(white_balance(plain.sensor) / (white - black))
    assert min(probe.header["per_dn"]) > 0
    assert "linear" not in planes(probe.header, probe.data)
