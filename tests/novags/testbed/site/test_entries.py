"""Claims about the entries of a site: which there are, what they are called, how they look, and their pages."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.folders.run import Run
from novags.testbed.report.material import Material, RunRecords
from novags.testbed.report.rows import looks_of
from novags.testbed.site.entries import Entry, SiteStudy, looks_of_all, pages_of, plain_name, studies_of, told_apart
from tests.novags.testbed.site.small_studies import PSNR, QUIET, dusk, night, studies, write_study


@pytest.mark.parametrize("failed", range(3))
def test_every_combination_with_a_score_is_an_entry(failed: int, tmp_path: Path) -> None:
    rows: list[Any] = [{"scene": scene, "electrons": 5, "method": method, PSNR: score}
                       for scene, method, score in (("attic", "better", 22.0), ("attic", "naive", 21.0),
                                                    ("barn", "naive", 20.0))]  # fmt: skip
    rows[failed]["state"] = "failed"
    (study,) = studies(tmp_path, dusk=rows)
    names = [(row["method"], row["scene"]) for k, row in enumerate(rows) if k != failed]
    assert [(entry.method, entry.scene) for entry in study.entries] == names


def test_an_entry_says_its_light_its_camera_and_all_other_axes(tmp_path: Path) -> None:
    levels = [{"scene": "hall", "level": level, "method": "naive", "width": 64, PSNR: 20.0} for level in ("1", "1/8")]
    photographs, alone = [{"photos": "hall", "method": "naive", PSNR: 20.0}], [{"method": "naive", PSNR: 20.0}]
    found = studies(tmp_path, dusk=dusk(), night=night(), levels=levels, photographs=photographs, alone=alone)
    said = [list(dict.fromkeys((e.scene, e.light, e.camera, e.rest) for e in study.entries)) for study in found]
    assert said == [
        [("attic", "5 electrons", "full frame", ""), ("attic", "50 electrons", "full frame", ""),
         ("barn", "5 electrons", "full frame", ""), ("barn", "50 electrons", "full frame", "")],
        [("barn", "2.5 electrons", "telephone", "width 64"), ("cave", "2.5 electrons", "telephone", "width 64")],
        [("hall", "1", "", "width 64"), ("hall", "1/8", "", "width 64")],
        [("hall", "photographs", "", "")],
        [("unknown", "photographs", "", "")],
    ]  # fmt: skip


def test_runs_of_several_captures_are_told_by_the_records_of_their_inputs(tmp_path: Path) -> None:
    """Their titles name the captures; a method has one name at all of them."""
    names, captures = ("a/naive", "b/naive"), ("first", "second")
    rows = [{"run": k, "capture": capture, "method": name, "state": "done", PSNR: 20.0 + k}
            for k, (capture, name) in enumerate(zip(captures, names, strict=True), 1)]  # fmt: skip
    record = {"name": "naive", "method": "naive", "enhancement": None}
    inputs: Any = (({"electrons": 20.0, "sensor_name": "telephone"}, {"scene": "cave"}), ({}, {}))
    made = {k: RunRecords(Run(tmp_path / name, record), name, tmp_path, captured, tmp_path / "hall", rendered)
            for k, (name, (captured, rendered)) in enumerate(zip(names, inputs, strict=True), 1)}  # fmt: skip
    looks = {name: replace(look, name=name) for name in names for look in looks_of(["naive"], {}).values()}
    axes = {"capture": captures, "method": names}
    study = SiteStudy("runs", tmp_path, Material(tmp_path / "index.html", rows, axes, looks, made, {}))
    assert [(entry.line.where, entry.method, entry.scene, entry.light, entry.camera) for entry in study.entries] == [
        ("first", "naive", "cave", "20 electrons", "telephone"), ("second", "naive", "hall", "photographs", "")
    ]  # fmt: skip
    assert [entry.runs for entry in study.entries] == [[made[1]], [made[2]]]


def test_every_folder_is_a_study_with_a_name_of_its_own(tmp_path: Path) -> None:
    rows = {"Dusk": dusk(), "dusk": night(), "a b": night()[:1], "more/dusk": dusk()[:2]}
    folders = [write_study(tmp_path / str(k) / name, own) for k, (name, own) in enumerate(rows.items())]
    found = studies_of(folders, tmp_path / "site", QUIET)
    assert [(study.name, study.folder, len(study.entries)) for study in found] == [
        ("Dusk", folders[0], 8), ("dusk-2", folders[1], 6), ("a-b", folders[2], 1), ("dusk-3", folders[3], 1)
    ]  # fmt: skip
    assert [study.page for study in found] == [f"studies/{study.name}/index.html" for study in found]
    assert [study.material.path for study in found] == [tmp_path / "site" / study.page for study in found]
    with pytest.raises(ValueError, match="name at least one folder"):
        studies_of([], tmp_path / "site", QUIET)


def test_a_study_offers_the_tables_that_it_has(tmp_path: Path) -> None:
    (study,) = studies(tmp_path, dusk=dusk())
    assert study.files == []
    for names in (["differences.csv"], ["results.csv", "differences.csv"]):
        (study.folder / names[0]).write_text("run\n1\n")
        assert study.files == [study.folder / name for name in names]


def test_a_method_looks_the_same_on_all_pages_and_like_no_other(tmp_path: Path) -> None:
    entries: list[Entry] = [entry for study in studies(tmp_path, dusk=dusk(), night=night()) for entry in study.entries]
    looks = looks_of_all(entries)
    assert {name: (look.name, look.key, look.method, look.competes) for name, look in looks.items()} == {
        "better": ("better", "m0", "naive", True), "naive": ("naive", "m1", "naive", True),
        "oracle": ("oracle", "m2", "oracle", False),
    }  # fmt: skip
    assert len({look.color for look in looks.values()}) == 3


def test_names_that_differ_have_pages_that_differ() -> None:
    found = pages_of(["naive*3", "naive-3", "Naive-3", "a:1", "../x", "naive*3"], "methods")
    assert [page.removeprefix("methods/") for page in found.values()] == [
        "naive-3.html", "naive-3-2.html", "Naive-3-3.html", "a-1.html", "x.html"
    ]  # fmt: skip
    assert list(found) == ["naive*3", "naive-3", "Naive-3", "a:1", "../x"]
    assert plain_name("...") == plain_name("ü") == "page"


def test_a_name_of_several_methods_or_settings_has_the_study_behind_it() -> None:
    """Rationale: a variant of the oracle stood as one of naive, among its rivals."""

    def entry(study: str, name: str, method: str, settings: dict[str, Any] | None) -> Entry:
        runs = [] if settings is None else [SimpleNamespace(run=SimpleNamespace(record={"variant": settings}))]
        material = SimpleNamespace(study=True, looks={name: SimpleNamespace(method=method)}, of=lambda _: runs)
        return Entry(SimpleNamespace(name=study, material=material), SimpleNamespace(method=name))  # type: ignore[arg-type]

    told = [("a", "v", "naive", {"eta": 1}), ("b", "v", "oracle", {"eta": 1}), ("a", "w", "naive", {"eta": 1}),
            ("b", "w", "naive", {"eta": 2}), ("a", "naive", "naive", {}), ("b", "naive", "naive", None)]  # fmt: skip
    found = told_apart([entry(*each) for each in told])
    assert [each.method for each in found] == ["v (a)", "v (b)", "w (a)", "w (b)", "naive", "naive"]
