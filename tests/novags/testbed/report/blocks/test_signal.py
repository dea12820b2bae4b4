"""Claims about the light that the pixels got: what the histogram counts and where it is drawn."""

import html
import json
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.folders.capture import Capture
from novags.testbed.report.blocks import signal as module
from novags.testbed.report.blocks.signal import SHARES, _chart, by_filter, histogram, signal
from novags.testbed.report.grid import Line
from simscenes.sets.pictures.exr import read_exr


@pytest.mark.parametrize("name", ["chips", "mosaic"])
def test_the_histogram_counts_the_electrons_of_each_filter(captures: dict[str, Capture], name: str) -> None:
    capture = captures[name]
    assert capture.sensor is not None
    found = histogram(capture, [0, 2])
    assert found is not None
    green = []
    for view in ("0000", "0002"):
        truth, _ = read_exr(capture.path / "truth" / f"{view}.exr")
        if name == "chips":
            green.append(truth["clean.G"].ravel())
        else:  # RGGB
            green += [truth["clean"][0::2, 1::2].ravel(), truth["clean"][1::2, 0::2].ravel()]
    electrons = (np.concatenate(green) - capture.sensor.black_level) / capture.sensor.gain
    lines = {line["name"]: line["points"] for line in plot(found["chart"])["lines"]}
    assert list(lines) == ["red", "green", "blue"]
    shares = np.array([float(point[3].rstrip("%")) / 100 for point in lines["green"]])
    assert shares.sum() == pytest.approx(1, abs=0.01)
    most = max(float(point[3].rstrip("%")) for line in lines.values() for point in line)
    beside = [float(text) for text in re.findall(r'text-anchor="end">([^<]*)<', found["chart"])]
    assert 0.5 * most < max(beside) <= most + 0.01  # numbers of the axis, in percent
    assert min(point[1] for line in lines.values() for point in line) == plot(found["chart"])["top"]
    centres = np.array([float(point[2]) for point in lines["green"]])
    assert (shares * centres).sum() == pytest.approx(electrons.mean(), rel=0.05)


def test_pixels_of_a_mosaic_count_for_the_colour_of_their_filter() -> None:
    found = by_filter(np.array([[1.0, 2.0], [3.0, 4.0]]), "GRBG")
    assert [[v for v in channel if v == v] for channel in found.T.tolist()] == [[2.0], [1.0, 4.0], [3.0]]


def plot(chart: str) -> Any:
    found = re.search(r'data-plot="([^"]*)"', chart)
    assert found is not None
    return json.loads(html.unescape(found[1]))


@pytest.mark.parametrize(("logarithmic", "middle"), [(True, "10"), (False, "50.5")])
def test_a_bin_of_a_chart_is_named_by_its_middle_on_the_axis(logarithmic: bool, middle: str) -> None:
    chart = _chart({"red": np.array([1.0])}, np.array([1.0, 100.0]), "electrons", logarithmic=logarithmic)
    ((_, _, named, _),) = plot(chart)["lines"][0]["points"]
    assert named == middle


@pytest.mark.parametrize("logarithmic", [True, False])
def test_the_axis_of_a_histogram_begins_at_its_first_edge_and_ends_at_its_last(
    logarithmic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list[Any]()
    monkeypatch.setattr(module, "Chart", lambda *a, **b: drawn.append(a) or SimpleNamespace(svg=lambda: ""))
    _chart({"red": np.array([0.5, 0.25])}, np.array([1.0, 10.0, 1000.0]), "electrons", logarithmic=logarithmic)
    ((_, x, y, _),) = drawn
    assert (x.low, x.high) == ((0.0, 3.0) if logarithmic else (1.0, 1000.0))
    assert (y.low, y.high) == (0.0, 50.0)


def test_the_histogram_reaches_from_the_darkest_pixels_to_the_brightest(
    captures: dict[str, Capture], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = dict[str, Any]()
    monkeypatch.setattr(module, "_chart", lambda shares, edges, *_, **__: found.update(shares=shares, edges=edges))
    capture = captures["chips"]
    assert capture.sensor is not None
    histogram(capture, [0, 1])
    electrons = np.stack(
        [(capture.truth(i, "clean") - capture.sensor.black_level) / capture.sensor.gain for i in (0, 1)]
    )
    seen = electrons[electrons > 0]
    assert found["edges"][0] == pytest.approx(np.quantile(seen, 0.001), rel=1e-5)
    assert found["edges"][-1] == pytest.approx(1.001 * seen.max(), rel=1e-5)
    for channel, shares in enumerate(found["shares"].values()):
        expected = np.histogram(electrons[..., channel], found["edges"])[0] / electrons[..., channel].size
        np.testing.assert_allclose(shares, expected, atol=2e-3)


def test_the_codes_of_photographs_are_of_all_views_that_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    found = dict[str, Any]()
    monkeypatch.setattr(module, "_chart", lambda shares, edges, *_, **__: found.update(shares))
    capture: Any = SimpleNamespace(imported=True, sensor=None, is_dark=lambda i: True,
                                   srgb8=lambda i: np.full((2, 2, 3), i / 255, np.float32))  # fmt: skip
    assert histogram(capture, [8, 80, 200]) is not None
    assert [np.flatnonzero(shares).tolist() for shares in found.values()] == [[2, 20, 50]] * 3


def test_every_combination_has_the_shares_that_a_run_of_it_knows() -> None:
    quantiles = {key: 10.0 * (k + 1) for k, key in enumerate(SHARES)}
    methods = {5: ("gone", "naive"), 50: ("naive", "gone")}
    lines = [Line({"electrons": e}, method, []) for e, names in methods.items() for method in names]
    captured = {"signal_quantiles_e": quantiles, "sensor_name": "eye"}
    here = {id(line): [SimpleNamespace(captured=captured)] for line in lines if line.method == "naive"}
    material: Any = SimpleNamespace(one=None, lines=lines, of=lambda line: here.get(id(line), []))
    found = signal(material, None)  # type: ignore[arg-type]
    assert found is not None
    rows = found["table"].rows
    assert [row.cells[0] for row in rows] == [lines[0].where, lines[2].where]
    assert [[cell.text for cell in row.cells[2:]] for row in rows] == [
        ["10.00", "20.00", "30.00", "40.00", "50.00"]
    ] * 2
    assert [column.heading for column in found["table"].columns][2:] == list(SHARES.values())
