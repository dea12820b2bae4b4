"""Claims about what a report is made of: places in tables, spreads, maps, pictures, the numbers under the probe."""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup

ROOT = Path(__file__).resolve().parents[4]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from novags.testbed.console.terminal import Console  # noqa: E402
from novags.testbed.folders.capture import Capture, open_capture  # noqa: E402
from novags.testbed.folders.exposures import exposures_of  # noqa: E402
from novags.testbed.report.look.pictures import _Tiles  # noqa: E402
from novags.testbed.report.page import write_report, write_reports  # noqa: E402
from novags.testbed.report.parts import Strip, Table, TableRow, heads, num, plain, text  # noqa: E402
from novags.testbed.report.tables import columns, per_view, ranked, scores_of  # noqa: E402
from novags.testbed.report.verdict import table_of  # noqa: E402
from novags.testbed.report.words import duration, join, number, signed, size  # noqa: E402
from sensor_model import srgb_to_linear  # noqa: E402
from simscenes.sets.pictures.exr import read_exr  # noqa: E402

QUIET = Console(quiet=True)


def metrics(**means: Any) -> dict[str, Any]:
    return {"methods": {name: {"mean": {"enhanced": mean}} for name, mean in means.items()}}


def test_rows_stand_best_first_and_what_sees_truth_takes_no_place() -> None:
    made = metrics(a={"aligned_psnr": 20.0, "flip": 0.1}, b={"aligned_psnr": None, "flip": 0.3},
                   c={"aligned_psnr": "inf", "flip": 0.2}, bound={"aligned_psnr": 30.0, "flip": 0.0})  # fmt: skip
    competes = {"a": True, "b": True, "c": True, "bound": False}
    found = ranked(scores_of(made, "enhanced"), columns("enhanced"), competes)
    assert [row["method"] for row in found] == ["c", "bound", "a", "b"]
    places = {row["method"]: {cell["key"]: cell["rank"] for cell in row["cells"]} for row in found}
    assert {name: place["aligned_psnr"] for name, place in places.items()} == {"a": 2, "b": None, "c": 1, "bound": None}
    assert {name: place["flip"] for name, place in places.items()} == {"a": 1, "b": 3, "c": 2, "bound": None}


def test_what_is_left_of_the_noise_stands_by_run_the_least_first(experiment: Path) -> None:
    page = (experiment / "report.html").read_text(encoding="utf-8")
    table = page[page.index('id="scores-noise"') :]
    rows = re.findall(r"<tr.*?</tr>", table[table.index("<tbody>") : table.index("</tbody>")], re.S)
    found = [[float(value) for value in re.findall(r'data-value="([\d.]+)"', row)] for row in rows]
    assert found == [[share, 1.0, 0.0625, 31.257] for share in (0.2025, 0.2375, 0.305)]  # of naive, better, oracle
    assert [word in row for word, row in zip(("naive", "better", "oracle"), rows, strict=True)] == [True] * 3
    assert "31.26" in rows[0]


def test_what_is_told_in_the_code_of_each_run_ranks_only_runs_of_one_enhancement() -> None:
    """Rationale: a darker tone has smaller changes of colour and less noise, and took the first place."""
    depth = {"within_5_percent": 0.5, "coverage": 1.0, "floaters": 0.0}
    scores = {name: {"geometry": {**depth, "abs_rel": value, "consistency": {"excess": value}},
                     "noise": dict.fromkeys(("renders", "targets", "known", "bias_floor"), value)}
              for name, value in (("dark", 0.1), ("bright", 0.2))}  # fmt: skip
    for tones in ("same", "same"), ("dark", "bright"):
        rows = {name: SimpleNamespace(name=name, competes=True, enhancement=tone)
                for name, tone in zip(scores, tones, strict=True)}  # fmt: skip
        material: Any = SimpleNamespace(rows=rows, metrics={"methods": scores}, one_reference=len(set(tones)) == 1)
        tables = [*table_of(material, "geometry"), *table_of(material, "noise")]
        ranks_of = {cell["key"]: cell["rank"] for row in tables if row["method"] == "dark" for cell in row["cells"]}
        alike = 1 if tones[0] == tones[1] else None
        assert (ranks_of["abs_rel"], ranks_of["coverage"]) == (1, 1)
        assert (ranks_of["consistency"], ranks_of["renders"], ranks_of["targets"]) == (alike, alike, alike)


def test_a_run_without_training_views_is_shown_in_the_held_out_ones_alone(experiment: Path, tmp_path: Path) -> None:
    """Rationale: programs render what is held out, and the page asked them for the other views too."""
    folder = tmp_path / "page"
    shutil.copytree(experiment, folder)
    path = folder / "better" / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"depth": False}))
    names, held_out = open_capture(folder / "capture").names, "0000"
    for name in set(names) - {held_out}:
        for kind in ("renders/{}.png", "exr/{}.exr"):
            (folder / "better" / kind.format(name)).unlink()
        for run in ("naive", "oracle"):
            (folder / run / "renders_train").mkdir(exist_ok=True)
            (folder / run / "renders" / f"{name}.png").rename(folder / run / "renders_train" / f"{name}.png")
    grids = write_report(folder, QUIET).read_text(encoding="utf-8").split('<div class="grid"')[1:]
    shown = [set(re.findall(r'<figure data-key="([^"]+)">', grid)) for grid in grids]
    assert len(shown) == len(names)
    assert {"render-better", "error-better", "render-naive", "depth-naive"} <= shown[0]
    assert not any("depth-better" in keys for keys in shown)
    for training in shown[1:]:
        assert {"render-naive", "error-naive", "depth-naive", "truth-lit"} <= training
        assert not any(key.endswith("-better") for key in training)
    for name in ("naive", "oracle"):
        shutil.rmtree(folder / name)
    alone = write_report(folder / "better", QUIET).read_text(encoding="utf-8")
    assert alone.count('data-key="render-better"') == 1


def test_the_shares_of_the_costs_are_of_the_whole_time_and_the_longest_stage_has_the_longest_bar(
    experiment: Path,
) -> None:
    page = (experiment / "report.html").read_text(encoding="utf-8")
    table = page[page.index('id="cost"') :]
    rows = re.findall(r"<tr.*?</tr>", table[table.index("<tbody>") : table.index("</tbody>")], re.S)
    seconds, shares, _ = zip(
        *([float(v) for v in re.findall(r'data-value="([^"]+)"', row)] for row in rows), strict=True
    )
    assert shares == pytest.approx([value / sum(seconds) for value in seconds])
    bars = [float(width) for row in rows for width in re.findall(r"width:([\d.]+)%", row)]
    assert bars == pytest.approx([100 * value / max(seconds) for value in seconds], abs=0.051)


def test_a_score_that_a_later_view_has_alone_is_told_of_all_views() -> None:
    views = {"0": {"lit": {"psnr": None}}, "1": {"lit": {"psnr": 20.0}}, "2": {"lit": {"psnr": 30.0}}}
    found = per_view({"methods": {"naive": {"mean": {"lit": {"psnr": 25.0}}, "views": views}}}, "lit")
    assert found is not None
    assert found["scores"]["psnr"]["values"] == [[None], [20.0], [30.0]]
    assert found["scores"]["psnr"]["spread"]["mean"] == [25.0]


def test_a_view_that_a_later_method_has_alone_has_its_row() -> None:
    methods = {name: {"mean": {"lit": {"psnr": 1}}, "views": {view: {"lit": {"psnr": 20.0}} for view in of}}
               for name, of in (("a", "0"), ("b", "01"))}  # fmt: skip
    found = per_view({"methods": methods}, "lit")
    assert found is not None
    assert found["views"] == ["0", "1"]
    assert found["scores"]["psnr"]["values"] == [[20.0, 20.0], [None, 20.0]]


def test_the_spread_over_views_is_that_of_the_views() -> None:
    views = {f"{k}": {"enhanced": {"aligned_psnr": value, "flip": value / 10, "lpips": None}}
             for k, value in enumerate((20.0, 26.0, 23.0))}  # fmt: skip
    views["3"] = {"enhanced": {"aligned_psnr": None, "flip": 9.0, "lpips": None}}
    found = per_view({"methods": {"a": {"mean": {"enhanced": {"flip": 1}}, "views": views}}}, "enhanced")
    assert found is not None
    assert found["views"] == ["0", "1", "2", "3"]
    assert list(found["scores"]) == ["aligned_psnr", "flip"]
    score = found["scores"]["aligned_psnr"]
    assert score["values"] == [[20.0], [26.0], [23.0], [None]]
    assert score["spread"] == {"mean": [23.0], "sd": [3.0], "worst": [20.0], "best": [26.0]}
    assert found["scores"]["flip"]["spread"]["worst"] == [9.0]
    assert found["scores"]["flip"]["spread"]["best"] == [2.0]
    assert per_view({"methods": {"a": {"mean": {"enhanced": None}, "views": {}}}}, "enhanced") is None


def test_every_method_has_its_own_spread_over_views() -> None:
    methods = {name: {"mean": {"lit": {"psnr": 1}}, "views": {f"{k}": {"lit": {"psnr": v}} for k, v in enumerate(of)}}
               for name, of in (("a", (20.0, 22.0)), ("b", (30.0, 36.0)), ("c", (25.0,)))}  # fmt: skip
    found = per_view({"methods": methods}, "lit")
    assert found is not None
    assert found["methods"] == ["a", "b", "c"]
    score = found["scores"]["psnr"]
    assert score["values"] == [[20.0, 30.0, 25.0], [22.0, 36.0, None]]
    assert score["spread"]["mean"] == [21.0, 33.0, 25.0]
    assert score["spread"]["worst"] == [20.0, 30.0, 25.0]
    assert score["spread"]["best"] == [22.0, 36.0, 25.0]


def test_true_normals_are_those_of_the_set_in_the_axes_of_the_camera(
    experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = dict[str, np.ndarray]()  # of the first view
    monkeypatch.setattr(_Tiles, "add", lambda self, key, label, note, image: found.setdefault(key, image))
    write_reports([experiment], QUIET, out=tmp_path / "page.html")
    truth, _ = read_exr(experiment / "set" / "gt" / "0000.exr")
    world = np.stack([truth[f"Ng.{axis}"] for axis in "XYZ"], -1)
    right, down, forward = open_capture(experiment / "capture").cameras.rig.viewmats[0][:3, :3]
    expected = 0.5 + 0.5 * np.stack([world @ right, -(world @ down), -(world @ forward)], -1)
    assert np.abs(found["normal-true"] - expected.clip(0, 1)).max() < 1e-6


def test_light_is_shown_at_the_exposures_of_the_dark_and_of_the_well_lit_pictures(captures: dict[str, Capture]) -> None:
    capture, rng = captures["chips"], np.random.default_rng(0)
    index = {name: i for i, name in enumerate(capture.names)}
    codes = np.minimum(rng.random((3, 24, 32, 3), np.float32) * 1.25, 1)
    codes[0] = 0  # a black view says nothing, and does no harm

    def of(rendering: Any, *, known: bool = True) -> Any:
        told = {"space": "linear", "enhancement": None, "lacks": None}
        run: Any = SimpleNamespace(**told, rendering=lambda name: rendering(index[name]))
        lit: Any = SimpleNamespace(lit_known=known, shows=lambda i: known, lit=lambda i: codes[i])
        return exposures_of(run, replace(capture, cameras=replace(capture.cameras, held_out=(0, 1, 2))), lit)

    assert of(lambda i: 0.25 * capture.clean_linear(i)).dark == pytest.approx(4)
    assert of(lambda i: 0.25 * capture.clean_linear(i), known=False).lit is None
    light = np.where(codes < 1, 0.125 * srgb_to_linear(codes), 9.0).astype(np.float32)
    assert of(lambda i: light[i]).lit == pytest.approx(8)  # whatever stands where the picture is white
    codes[:] = 1
    assert of(lambda i: light[i]).lit is None


def test_the_best_method_is_marked_and_the_oracle_does_not_compete() -> None:
    metrics = {"methods": {"nova": method(25.0, flip=0.2), "naive": method(20.0), "oracle": method(30.0)}}
    values, competes = scores_of(metrics, "enhanced"), {"nova": True, "naive": True, "oracle": False}
    marked = {
        (row["method"], cell["key"])
        for row in ranked(values, columns("enhanced"), competes)
        for cell in row["cells"]
        if cell["best"]
    }
    assert ("nova", "aligned_psnr") in marked
    assert ("naive", "flip") in marked
    assert not any(name == "oracle" for name, _ in marked)
    assert not any(key == "lpips" for _, key in marked)
    none = ranked(values, columns("enhanced"), competes, lambda name, key: False)
    assert not any(cell["best"] or cell["rank"] for row in none for cell in row["cells"])
    assert [row["competes"] for row in none] == [False, True, True]  # who is a bound stays known


def method(value: float, **others: Any) -> dict[str, Any]:
    scores = {"psnr": value - 1, "aligned_psnr": value, "ssim": 0.5, "aligned_ssim": 0.6, "flip": 0.1, "lpips": None}
    return {"mean": {"enhanced": {**scores, **others}, "lit": {**scores, "tone_aligned_psnr": value / 2}}}


def test_words_for_numbers() -> None:
    assert [duration(s) for s in (0.04, 9.9, 59.6, 119.0, 150.0, 7260.0)] == [
        "0.0 s", "9.9 s", "60 s", "119 s", "2 min 30 s", "2 h 01 min",
    ]  # fmt: skip
    assert [size(b) for b in (5e5, 2.5e9)] == ["0 MB", "2.5 GB"]
    assert [join(w) for w in (["a"], ["a", "b"], ["a", "b", "c"])] == ["a", "a and b", "a, b and c"]
    assert [number(v) for v in (1.234, None, "inf")] == ["1.23", "unavailable", "inf"]
    assert [signed(v) for v in (1.0, -0.5)] == ["+1.00", "−0.50"]


def test_a_table_as_text_leaves_out_columns_that_say_the_same_in_every_row() -> None:
    rows = [TableRow([name, num(value, 1), num(None, "none"), other])
            for name, value, other in (("a", 5.0, "x"), ("long", 10.25, "x"), ("mid", 7.0, "y"))]  # fmt: skip
    table = Table("t", "", heads("Name | #Score [dB] | #LPIPS | Other"), rows)
    assert table.same == {2: "none"}
    assert plain(table) == ["Name  Score dB  Other", "a          5.0  x", "long      10.2  x", "mid        7.0  y"]
    assert Table("t", "", table.columns, rows, foot=rows).same == {}  # the reader changes what it shows
    assert Table("t", "", table.columns, rows[:1]).same == {}
    assert Table("t", "", table.columns, rows[:2]).same == {2: "none", 3: "x"}


def test_what_every_row_says_is_said_with_its_small_print_and_text_stays_text() -> None:
    rows = [TableRow(["a", num(1.0, Markup("1.00 <small>± 0.00</small>")), text("<b>")])] * 2
    assert Table("t", "", heads("Name | #Score | Other"), rows).same == {
        1: "1.00 <small>± 0.00</small>", 2: "&lt;b&gt;",
    }  # fmt: skip
    assert all(isinstance(said, Markup) for said in Table("t", "", heads("Name | #Score | Other"), rows).same.values())


def test_the_grid_of_a_view_leaves_out_every_picture_of_the_strip() -> None:
    tiles: Any = [SimpleNamespace(key=key) for key in ("dark", "render-naive", "truth-lit")]
    assert Strip(SimpleNamespace(), tiles).keys == {"dark", "render-naive", "truth-lit"}  # type: ignore[arg-type]
