"""The tables of docs/paper-length.md: fits that were made in parts stand beside each other as if made at once."""

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = "".join(f"<!-- table: {name} -->\n<!-- /table -->\n" for name in ("s", "s-along", "s-scenes", "s-stops"))
SCORES = {"enhanced": ("aligned_psnr", "aligned_ssim", "st_lpips", "flip"), "lit": ("tone_aligned_psnr",)}


@pytest.fixture
def lengths(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "choices"))
    for name in ("lengths", "settle"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    import lengths  # type: ignore[import-not-found]

    monkeypatch.setattr(lengths, "read_scores", lambda run: json.loads((run / "scores.json").read_text("utf-8")))

    return lengths


def study(folder: Path, runs: list[tuple[str, str, int, float]]) -> Path:
    """A study's folder with runs of these methods, scenes, seeds and values."""
    rows = []
    for method, scene, seed, value in runs:
        run = folder / f"{method}-{scene.replace(':', '-')}-{seed}"
        run.mkdir(parents=True)
        by_view = {
            view: {kind: {name: value + step for name in names} for kind, names in SCORES.items()}
            for view, step in (("0003", 0.0), ("0008", 0.25))
        }
        mean = {kind: {name: value + 0.125 for name in names} for kind, names in SCORES.items()}
        early = {
            view: {kind: {n: v - 1 - seed for n, v in own.items()} for kind, own in kinds.items()}
            for view, kinds in by_view.items()
        }
        scores = {"mean": mean, "views": by_view, "along": [{"iterations": 400, "mean": mean, "views": early}],
                  "held_out": {"stop": 400} if method == "naive" else None}  # fmt: skip
        (run / "scores.json").write_text(json.dumps(scores), "utf-8")
        (run / "run.json").write_text(json.dumps({"enhancement": {"enhancer": "e", "config": {"a": 1}}}), "utf-8")
        rows.append({"state": "done", "method": method, "scene": scene, "seed": seed, "folder": run.name})
    rows.append({"state": "failed", "method": "nova", "scene": "a:1", "seed": 9, "folder": "none"})
    (folder / "results.json").write_text(json.dumps({"axes": {}, "rows": rows}), "utf-8")
    return folder


NAIVE = [("naive", "a:1", 0, 20.0), ("naive", "b:1", 0, 22.0), ("naive", "a:1", 1, 21.0)]
NOVA = [("nova", "a:1", 0, 23.5), ("nova", "b:1", 0, 24.5)]


def tables(lengths: ModuleType, monkeypatch: pytest.MonkeyPatch, page: Path, *arguments: str | Path) -> str:
    page.write_text(PAGE, "utf-8")
    monkeypatch.setattr(sys, "argv", ["lengths.py", *map(str, arguments), "--page", str(page)])
    lengths.main()
    return page.read_text("utf-8")


def test_fits_of_two_parts_make_the_tables_of_all_of_them(lengths, monkeypatch, tmp_path):
    kept, page = tmp_path / "fits.csv", tmp_path / "page.md"
    whole = tables(lengths, monkeypatch, page, study(tmp_path / "whole" / "s", NAIVE + NOVA))
    tables(lengths, monkeypatch, page, study(tmp_path / "one" / "s", NAIVE), "--kept", kept)
    parts = tables(lengths, monkeypatch, page, study(tmp_path / "two" / "s", NOVA), "--kept", kept)
    assert whole.replace("5 of 6 runs", "5 runs") == parts
    assert "+3.00" in parts  # of a:1 and b:1 at seed 0, which both have
    assert "2.50" in parts


def test_the_kept_fits_alone_make_the_tables_but_for_the_one_of_stops(lengths, monkeypatch, tmp_path):
    kept, page = tmp_path / "fits.csv", tmp_path / "page.md"
    whole = tables(lengths, monkeypatch, page, study(tmp_path / "one" / "s", NAIVE + NOVA), "--kept", kept)
    before = kept.read_bytes()
    alone = tables(lengths, monkeypatch, page, tmp_path / "nowhere" / "s", "--kept", kept)
    stops = "<!-- table: s-stops -->\n"
    assert alone == whole.partition(stops)[0] + stops + "<!-- /table -->\n"
    assert kept.read_bytes() == before
    with pytest.raises(FileNotFoundError):
        tables(lengths, monkeypatch, page, tmp_path / "nowhere" / "s")


def test_a_fit_that_is_made_again_takes_the_place_of_the_kept_one(lengths, monkeypatch, tmp_path):
    kept, page = tmp_path / "fits.csv", tmp_path / "page.md"
    tables(lengths, monkeypatch, page, study(tmp_path / "one" / "s", NAIVE), "--kept", kept)
    again = tables(
        lengths, monkeypatch, page, study(tmp_path / "two" / "s", [("naive", "b:1", 0, 40.0)]), "--kept", kept
    )
    assert "3 runs" in again
    assert [fit.stop for fit in lengths.read_kept(kept)] == [400] * 3
    values = lengths.together(lengths.read_kept(kept), "naive", "lit", "tone_aligned_psnr", 400, scene="b:1")
    assert values == {("b:1", "0", "0003"): 39.0, ("b:1", "0", "0008"): 39.25}


def test_of_an_axis_one_value_can_be_taken_and_another_is_refused(lengths, monkeypatch, tmp_path):
    folder, page = study(tmp_path / "s", NAIVE + NOVA), tmp_path / "page.md"
    rows = json.loads((folder / "results.json").read_text("utf-8"))["rows"]
    for row in rows:
        row |= {"electrons": 20 if row["scene"] == "a:1" else 5, "sensor": "x"}
    axes = dict.fromkeys(("method", "scene", "seed", "electrons", "sensor"), [])
    (folder / "results.json").write_text(json.dumps({"axes": axes, "rows": rows}), "utf-8")
    monkeypatch.setattr(sys.modules[__name__], "PAGE", PAGE.replace("table: s", "table: s-5-x"))
    found = tables(lengths, monkeypatch, page, folder, "--only", "electrons=5", "sensor=x")
    assert "2 of 2 runs" in found
    assert "+2.50" in found  # of b:1 alone
    with pytest.raises(SystemExit, match=r"no run of .* has electrons=7: 20, 5"):
        tables(lengths, monkeypatch, page, folder, "--only", "electrons=7")
    with pytest.raises(SystemExit, match="has several values of electrons: name one by --only electrons=20"):
        tables(lengths, monkeypatch, page, folder, "--only", "sensor=x")


def test_the_own_stop_loses_what_the_best_length_is_above_it(lengths, monkeypatch, tmp_path):
    """Fits of seed 0 are 1 dB worse after 400 iterations, where `naive` stops itself, of seed 1 2 dB; `nova` holds
    nothing out.
    """
    held = study(tmp_path / "held", NAIVE)
    found = tables(lengths, monkeypatch, tmp_path / "page.md", study(tmp_path / "s", NAIVE + NOVA), "--stops", held)
    rows = {row.split("|")[1].strip(): [cell.strip() for cell in row.split("|")[2:]] for row in found.splitlines()
            if row.startswith("|")}  # fmt: skip
    assert rows["`naive`"][:4] == ["21.12", "19.79", "21.12", "1.00 (2.00)"]
    assert rows["`naive`"][8] == "400, 400, 400"
    assert rows["`nova`"][:4] == ["24.12", "–", "24.12", "–"]
