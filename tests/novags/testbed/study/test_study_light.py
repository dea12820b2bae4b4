"""Curves over the light: what is averaged over what, and where a curve counts as broken."""

import csv
import json
import math
import re
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.report.page import write_study
from novags.testbed.report.rows import looks_of
from novags.testbed.report.study import is_study
from novags.testbed.study.light import MEASURES, Measure, _knee, common_knee, knee_of, light_curves

FALL = Measure("psnr", "enhanced.aligned_psnr", "PSNR", "dB", "below", 3.0)
RISE = Measure("depth", "geometry.abs_rel", "depth", "", "above", 2.0)
Row = dict[str, Any]
LINE = '<path class="line'


def row(electrons: float, method: str, seed: int, psnr: float | None, **more: Any) -> Row:
    scores = {} if psnr is None else {"enhanced.aligned_psnr": psnr}
    return {"scene": "a", "electrons": electrons, "method": method, "seed": seed, "state": "done", "stage": None,
            "reason": None, "run": 1, **scores, **more}  # fmt: skip


def axes(rows: list[Row]) -> dict[str, list[Any]]:
    return {name: list(dict.fromkeys(r[name] for r in rows)) for name in ("scene", "electrons", "method", "seed")}


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        # from 30 to 24 between 4 and 16: 27 is half the way in the logarithm
        ({64: 30.0, 16: 30.0, 4: 24.0, 1: 10.0}, 8.0),
        ({64: 30.0, 16: 27.0, 4: 27.0, 1: 27.0}, None),  # exactly on the limit has not fallen below it
        # the first one met from the bright end
        ({64: 30.0, 16: 26.0, 4: 29.0, 1: 20.0}, 64 ** (1 / 4) * 16 ** (3 / 4)),
        ({64: 30.0, 16: 29.0, 4: None, 1: 29.0}, 16.0),  # a failed run: this much light was enough
        ({64: None, 16: 20.0}, None),
        ({}, None),
    ],
)
def test_a_curve_breaks_where_it_falls_below_its_own_bright_value(
    values: dict[float, float | None], expected: float | None
) -> None:
    assert knee_of(values, FALL) == (None if expected is None else pytest.approx(expected))


def test_the_order_of_levels_does_not_matter() -> None:
    assert knee_of({1: 10.0, 64: 30.0, 4: 24.0, 16: 30.0}, FALL) == pytest.approx(8.0)


def test_an_error_breaks_where_it_has_doubled() -> None:
    assert knee_of({100: 0.02, 10: 0.03, 1: 0.05}, RISE) == pytest.approx(10**0.5)
    assert knee_of({100: 0.02, 10: 0.03, 1: 0.04}, RISE) is None


def test_the_knee_of_all_seeds_is_their_geometric_mean_with_its_spread() -> None:
    both = common_knee([2.0, 8.0])
    assert (both.electrons, both.low, both.high, both.seeds, both.broken) == (pytest.approx(4.0), 2.0, 8.0, 2, 2)
    one = common_knee([2.0, None])
    assert (one.electrons, one.low, one.high, one.seeds, one.broken) == (None, 2.0, 2.0, 2, 1)


def test_points_average_over_seeds_alone_and_name_what_failed() -> None:
    rows = [row(e, m, s, 20 + 2 * s + (m == "b") + math.log2(e)) for e in (1, 4) for m in "ab" for s in (0, 1)]
    rows[0] |= {"state": "failed", "enhanced.aligned_psnr": None}
    curves = light_curves(rows, axes(rows))
    found = {(c.method, c.measure.key): c for c in curves}
    assert set(found) == {("a", "psnr"), ("b", "psnr")}
    dark, bright = found["a", "psnr"].levels
    assert (dark.electrons, dark.values, dark.failed, dark.sd) == (1.0, (22.0,), 1, None)
    assert (bright.mean, bright.sd, bright.failed) == (23.0, pytest.approx(math.sqrt(2)), 0)
    assert found["b", "psnr"].slope == pytest.approx(1.0)  # dB per doubling
    assert found["b", "psnr"].place == {"scene": "a"}
    assert found["a", "psnr"].knee is not None
    assert (found["a", "psnr"].knee.broken, found["a", "psnr"].knee.seeds) == (1, 2)


def test_a_finished_run_without_a_score_has_not_failed() -> None:
    rows = [row(e, m, 0, 20 + e, **({"recovered": 0.5} if (e, m) == (4, "a") else {})) for e in (1, 4) for m in "ab"]
    shares = [c for c in light_curves(rows, axes(rows)) if c.measure.key == "recovered"]
    assert [[(level.values, level.failed) for level in c.levels] for c in shares] == [[((), 0), ((0.5,), 0)]]


def test_a_run_that_found_no_cameras_registers_no_views() -> None:
    """Any other failure says nothing about registration."""
    share = "cameras.registered_share"
    rows = [row(8, "a", 0, 25.0, **{share: 1.0}), row(1, "a", 0, None, state="failed", stage="cameras")]
    registered = next(c for c in light_curves(rows, axes(rows)) if c.measure.key == "registered")
    assert [level.values for level in registered.levels] == [(0.0,), (1.0,)]
    assert registered.knee is not None
    assert registered.knee.electrons == pytest.approx(8 ** (1 - 0.1))
    rows[1]["stage"] = "reconstruct a"
    registered = next(c for c in light_curves(rows, axes(rows)) if c.measure.key == "registered")
    assert [(level.values, level.failed) for level in registered.levels] == [((), 1), ((1.0,), 0)]


def test_a_seed_that_failed_at_the_most_light_is_unknown_and_not_one_that_does_not_break(
    study: Callable[..., Path],
) -> None:
    psnr = {1: 12.0, 4: 20.0, 16: 22.0}
    rows = [row(e, m, s, psnr[e]) for m in ("naive", "mine") for s in (0, 1) for e in psnr]
    for failed in rows:
        if failed["electrons"] == 16 and (failed["method"], failed["seed"]) != ("naive", 0):
            failed |= {"state": "failed", "enhanced.aligned_psnr": None}
    one, none = light_curves(rows, axes(rows))
    assert (one.bright, none.bright, none.slope) == (22.0, None, None)
    assert one.knee is not None
    assert (one.knee.seeds, one.knee.broken, one.knee.unknown) == (2, 1, 1)
    assert one.knee.electrons == one.knee.low == one.knee.high == knee_of(psnr, FALL)
    assert none.knee is not None
    assert vars(none.knee) == {"electrons": None, "low": None, "high": None, "seeds": 2, "broken": 0, "unknown": 2}
    folder = study(rows)
    page = write_study(folder).read_text(encoding="utf-8")
    table = page[page.index('data-name="knees"') :]
    assert table[: table.index("</tbody>")].count(">unknown<") == 3
    first, second = list(csv.DictReader((folder / "light-knees.csv").read_text().splitlines()))
    assert (first["bright"], second["bright"], second["unknown"]) == ("22.0", "", "2")


def test_while_the_most_light_is_still_to_come_no_curve_falls_from_less() -> None:
    """Rationale: the brightest level that was finished stood for it in the table of knees."""
    rows = [row(e, "naive", 0, {1: 12.0, 4: 20.0}.get(e)) for e in (1, 4, 16)]
    rows[-1]["state"] = "waiting"
    (curve,) = light_curves(rows, axes(rows))
    assert (curve.bright, curve.slope) == (None, None)
    assert curve.knee is not None
    assert (curve.knee.electrons, curve.knee.broken, curve.knee.unknown) == (None, 0, 1)
    assert [(level.values, level.failed) for level in curve.levels] == [((12.0,), 0), ((20.0,), 0), ((), 0)]


def test_one_light_level_makes_no_curve() -> None:
    rows = [row(4, "a", 0, 20.0)]
    with pytest.raises(ValueError, match="two values or more of electrons"):
        light_curves(rows, axes(rows))


def test_every_measure_that_breaks_says_how() -> None:
    assert {m.key: m.rule for m in MEASURES} == {
        "psnr": "3 dB below the value at the most light", "lit": "3 dB below the value at the most light",
        "recovered": None, "registered": "0.1 below the value at the most light",
        "depth": "2 times the value at the most light",
    }  # fmt: skip


@pytest.fixture
def study(tmp_path: Path) -> Callable[[list[Row]], Path]:
    """A folder of a study with these rows."""

    def make(rows: list[Row]) -> Path:
        (tmp_path / "results.json").write_text(json.dumps({"axes": axes(rows), "columns": [], "rows": rows}))
        variant = {"mine": {"method": "naive", "fit.iterations": 5}}
        (tmp_path / "study.json").write_text(json.dumps({"file": "l.toml", "table": {"variant": variant}}))
        return tmp_path

    return make


def test_the_report_of_a_study_shows_the_curves_and_writes_their_numbers(study: Callable[..., Path]) -> None:
    rows = [row(e, m, s, 20 + 3 * math.log2(e) + s) for e in (1, 2, 4) for m in ("naive", "mine") for s in (0, 1)]
    folder = study(rows)
    assert is_study(folder)
    page = write_study(folder).read_text(encoding="utf-8")
    drawn = (folder / "light-psnr.svg").read_text(encoding="utf-8")
    assert drawn.count(LINE) == 2
    assert page.count(LINE) == 2 * 2  # on the first screen, and among the curves
    assert drawn.count("breaks at 2<") == 2  # 3 dB are one doubling: from 4 to 2
    record = json.loads((folder / "light.json").read_text())
    assert [c["knee"]["electrons"] for c in record["curves"]] == [pytest.approx(2.0)] * 2
    assert [level["mean"] for level in record["curves"][0]["levels"]] == [20.5, 23.5, 26.5]
    points = (folder / "light.csv").read_text().splitlines()
    assert points[0] == "measure,scene,method,electrons,mean,sd,least,largest,seeds,failed"
    assert points[1].startswith("psnr,a,naive,1.0,20.5,0.7071")
    assert len(points) == 1 + 6
    assert (folder / "light-knees.csv").read_text().count("\n") == 3
    table = page[page.index('data-name="knees"') :]
    head, body = table[table.index("<thead>") : table.index("</thead>")], table[table.index("<tbody>") :]
    assert re.findall(r">([^<>]+)</th>", head)[:2] == ["score", "scene"]  # words, and no names of columns
    assert body.count(">aligned PSNR against the noise-free exposure<") == 2
    assert not re.search(r"https?://(?!www\.w3\.org)", page + drawn)


def test_a_picture_for_each_place_where_places_differ(study: Callable[..., Path]) -> None:
    rows = [row(e, "naive", 0, 20.0 + e) | {"scene": place} for e in (1, 2) for place in ("a", "b c")]
    folder = study(rows)
    write_study(folder)
    assert sorted(path.name for path in folder.glob("*.svg")) == ["light-psnr-scene-a.svg", "light-psnr-scene-b-c.svg"]


def test_bars_reach_from_the_worst_to_the_best_seed_and_bounds_are_dashed(study: Callable[..., Path]) -> None:
    rows = [row(e, m, s, 20 + 4 * s) for e in (1, 2) for m in ("naive", "oracle") for s in (0, 1)]
    folder = study(rows)
    page, drawn = write_study(folder).read_text("utf-8"), (folder / "light-psnr.svg").read_text("utf-8")
    assert escape('"22 (20 to 24)"') in page
    assert [kind.split()[0] for kind in re.findall(f'{LINE} (.*?)"', drawn)] == ["m0", "bound"]
    feet = {text: float(y) - 4 for y, text in re.findall(r'y="([\d.]+)" text-anchor="end">([^<]*)<', drawn)}
    bars = re.findall(r",([\d.]+)V([\d.]+)", "".join(re.findall(r'class="spread [^"]*" d="([^"]*)"', drawn)))
    assert [(float(low), float(high)) for low, high in bars] == [pytest.approx((feet["20"], feet["24"]), abs=0.11)] * 4


def test_places_that_differ_in_capitals_or_umlauts_alone_have_pictures_of_their_own(
    study: Callable[..., Path],
) -> None:
    """Rationale: they had one file, and the page showed the curves of the last of them under every title."""
    names = {"Küche": 20.0, "köche": 30.0, "kche": 40.0, "k che": 50.0}
    rows = [row(e, "naive", 0, value + e) | {"scene": place} for e in (1, 2) for place, value in names.items()]
    folder = study(rows)
    page = write_study(folder).read_text(encoding="utf-8")
    files = re.findall(r'<a href="(light-psnr[^"]*)">', page)
    assert len(set(files)) == len(files) == 4
    for file, (place, value) in zip(files, names.items(), strict=True):
        assert f"scene {place}" in (folder / file).read_text(encoding="utf-8")
        chart = page[page.index(f"scene {place}</h4>") :].partition("</svg>")[0]
        assert all(escape(f'"{value + electrons:g}"') in chart for electrons in (1, 2))


def test_a_curve_of_one_level_has_no_slope_and_the_table_does_not_say_that_it_was_not_reached(
    study: Callable[..., Path],
) -> None:
    page = write_study(study([row(1, "naive", 0, 20.0), row(2, "mine", 0, 21.0)])).read_text(encoding="utf-8")
    table = page[page.index('data-name="knees"') :]
    rows = re.findall(r"<tr>(.*?)</tr>", table[table.index("<tbody>") : table.index("</tbody>")])
    told = [re.sub("<[^>]+>", "|", text).replace("||", "|").strip("|").split("|") for text in rows]
    never = ["not reached"] * 3
    assert [cells[4:] for cells in told] == [
        ["20", *never, "1", "0", "0"],
        ["21", *never, "1", "0", "0"],
    ]  # and no slope


def test_a_report_elsewhere_replaces_files_of_the_same_study_alone(
    study: Callable[..., Path], tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = study([row(e, "naive", 0, 20.0 + e) for e in (1, 2)])
    for name in ("page.html", "light.csv", "light-other.svg"):
        out = tmp_path / name.replace(".", "-") / "page.html"
        out.parent.mkdir()
        foreign = out.with_name(name)
        foreign.write_text("mine")
        assert call("report", str(folder), "--out", str(out)) == 2
        assert foreign.read_text() == "mine"
        assert f"{foreign} already exists and is not of a report on this study" in capsys.readouterr().err
        assert call("report", str(folder), "--out", str(out), "--overwrite") == 0
        assert LINE in out.read_text(encoding="utf-8")
        assert call("report", str(folder), "--out", str(out)) == 0  # its own is made again
    assert call("report", str(folder)) == 0
    assert call("report", str(folder), "--out", str(folder / "results.json")) == 2


def test_a_study_with_nothing_done_says_so(study: Callable[..., Path]) -> None:
    rows = [row(e, "naive", 0, None, state="failed", stage="x") for e in (1, 2)]
    with pytest.raises(ValueError, match="no finished run to show"):
        write_study(study(rows))


def test_colours_of_variants_differ_and_bounds_are_dashed() -> None:
    tables = {"variant": {"mine": {"method": "naive"}}, "method": {"theirs": {"command": "x {capture} {out}"}}}
    looks = looks_of(["naive", "mine", "oracle", "theirs"], tables)
    assert len({look.color for look in looks.values()}) == 4
    assert [look.competes for look in looks.values()] == [True, True, False, True]


def test_what_sees_truth_by_the_settings_of_the_study_is_a_bound_and_what_does_not_competes() -> None:
    """Rationale: the settings of variants were not looked at, so that one that sees truth took places."""
    own = {"peek": {"method": "i2-nerf", "truth_statistics": True},
           "blind": {"method": "i2-nerf-truth", "truth_statistics": False},
           "again": {"method": "peek", "fit": {"iterations": 5}}}  # fmt: skip
    names = ["i2-nerf", "i2-nerf-truth", *own]
    bounds = {name: not look.competes for name, look in looks_of(names, {"variant": own}).items()}
    assert bounds == {"i2-nerf": False, "i2-nerf-truth": True, "peek": True, "blind": False, "again": True}
    for_all = looks_of(["naive", "i2-nerf", "blind"], {"variant": own, "override": {"truth_statistics": "true"}})
    assert [look.competes for look in for_all.values()] == [True, False, True]


def test_every_other_axis_is_part_of_the_place_of_a_curve() -> None:
    rows = [row(e, m, s, 20 + e, scene=scene, sensor=sensor) for e in (1, 4) for m in "ab" for s in (0, 1)
            for scene in "uv" for sensor in ("x", "y")]  # fmt: skip
    more = {"scene": list("uv"), "sensor": ["x", "y"], **{name: axes(rows)[name] for name in ("electrons", "method")}}
    curves = light_curves(rows, {**more, "seed": [0, 1]})
    assert [(c.place, c.method) for c in curves] == [
        ({"scene": scene, "sensor": sensor}, method) for method in "ab" for scene in "uv" for sensor in ("x", "y")
    ]
    assert {len(level.values) for c in curves for level in c.levels} == {2}


def test_the_knee_of_all_seeds_counts_all_and_those_that_are_unknown() -> None:
    seeds = [{1.0: 10.0, 4.0: 30.0}, {1.0: 10.0, 4.0: None}, {1.0: 30.0, 4.0: 30.0}, {1.0: 20.0, 4.0: 30.0}]
    found = _knee(seeds, 4.0, FALL)
    assert (found.seeds, found.broken, found.unknown) == (4, 2, 1)
    known = [knee_of(seeds[k], FALL) for k in (0, 3)]
    assert (found.low, found.high) == (min(known), max(known))  # type: ignore[type-var]
