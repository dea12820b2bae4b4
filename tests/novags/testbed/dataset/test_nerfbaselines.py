"""Claims about results in the layout of nerfbaselines."""

import base64
import hashlib
import io
import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.dataset.nerfbaselines import _method_of, export_results
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.run import open_run
from novags.testbed.ledger.contents import read_json
from novags.testbed.ledger.dry import dry_run
from simscenes.sets.pictures.png import read_png
from tests.fuzz.readers.records import make_run

QUIET = Console(quiet=True)
METHODS, VIEWS = ("naive", "oracle"), ("0000", "0008")
LIGHTS = (200.0, 50.0)


@pytest.fixture(scope="module")
def experiments(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two runs each, of captures of nine views in two lights."""
    found = [tmp_path_factory.mktemp("exported") / f"{light:g}" for light in LIGHTS]
    for folder, light in zip(found, LIGHTS, strict=True):
        folder.mkdir()
        make_run(folder, views=9, electrons=light)
    return found


@pytest.fixture(scope="module")
def exported(experiments: list[Path]) -> Path:
    return export_results(experiments, experiments[0].parent / "out", QUIET).parent


def scenes(experiments: list[Path]) -> list[str]:
    records = [open_capture(folder / "capture").record for folder in experiments]
    assert records[0].scene == records[1].scene
    return [f"{r.scene}-{r.sensor_name}-{light:g}e-s0" for r, light in zip(records, LIGHTS, strict=True)]


def values(record: dict[str, str], name: str) -> list[float]:
    raw = base64.b64decode(record[name])
    return list(struct.unpack(f"<{len(raw) // 4}f", raw))


def test_every_held_out_view_is_scored_and_shown(experiments: list[Path], exported: Path) -> None:
    for folder, scene in zip(experiments, scenes(experiments), strict=True):
        for method in METHODS:
            place = exported / method / scene
            shown = {kind: sorted((place / "predictions" / kind).iterdir()) for kind in ("color", "gt-color")}
            assert [[path.stem for path in paths] for paths in shown.values()] == [list(VIEWS)] * 2
            record = read_json(place / "results.json")
            for kind, name in (("color", "predictions_sha256"), ("gt-color", "ground_truth_sha256")):
                assert record[name] == hashlib.sha256(b"".join(p.read_bytes() for p in shown[kind])).hexdigest()
            errors = [np.abs(read_png(a).astype(float) - read_png(b)) for a, b in zip(*shown.values(), strict=True)]
            assert values(record["metrics_raw"], "mae") == pytest.approx([e.mean() for e in errors], rel=1e-5)
            assert record["metrics"]["mae"] == pytest.approx(np.mean(errors), abs=1e-5)
            run = open_run(folder / method)
            for a, view in zip(shown["color"], VIEWS, strict=True):
                np.testing.assert_allclose(read_png(a), np.clip(run.rendering(view), 0, 1), atol=0.501 / 255)


def test_the_checksum_is_over_all_scores_by_name_and_sorted(experiments: list[Path], exported: Path) -> None:
    record = read_json(exported / "naive" / scenes(experiments)[0] / "results.json")
    total = hashlib.sha256()
    for name in sorted(record["metrics_raw"]):
        total.update(name.encode())
        found = sorted(values(record["metrics_raw"], name))
        assert len(found) == len(VIEWS)
        total.update(base64.b64encode(struct.pack(f"<{len(found)}f", *found)) + b"\n")
    assert record["metrics_sha256"] == total.hexdigest()


def test_the_table_has_every_method_scene_and_score_and_means_over_scenes(
    experiments: list[Path], exported: Path
) -> None:
    table = read_json(exported / "results.json")
    assert [scene["id"] for scene in table["scenes"]] == scenes(experiments)
    metrics = [metric["id"] for metric in table["metrics"]]
    assert {"psnr", "ssim", "mae", "mse"} <= set(metrics)
    assert [method["id"] for method in table["methods"]] == list(METHODS)
    for method in table["methods"]:
        records = [read_json(exported / method["id"] / scene / "results.json") for scene in scenes(experiments)]
        assert [method["scenes"][scene]["psnr"] for scene in scenes(experiments)] == [
            record["metrics"]["psnr"] for record in records
        ]
        for name in metrics:
            assert method[name] == pytest.approx(np.mean([r["metrics"][name] for r in records]), abs=2e-5)
        assert method["total_train_time"] == 2.0


def test_a_dry_run_names_the_files_of_every_run(experiments: list[Path], tmp_path: Path) -> None:
    stream = io.StringIO()
    with dry_run():
        export_results(experiments, tmp_path / "out", Console(stream=stream))
    for method in METHODS:
        for scene in scenes(experiments):
            assert f"to be made in {tmp_path}/out/{method}/{scene}: results.json" in stream.getvalue()


def test_a_method_that_lacks_a_scene_has_no_means(experiments: list[Path], tmp_path: Path) -> None:
    folder = shutil.copytree(experiments[1], tmp_path / "part")
    shutil.rmtree(folder / "oracle")
    table = json.loads((folder / "results.json").read_text())
    (folder / "results.json").write_text(json.dumps(table | {"rows": table["rows"][:1]}))
    made = read_json(export_results([experiments[0], folder], tmp_path / "out", QUIET))
    assert {row["id"]: (len(row["scenes"]), "psnr" in row) for row in made["methods"]} == {
        "naive": (2, True), "oracle": (1, False)
    }  # fmt: skip


def test_two_runs_of_a_method_on_the_same_scene_have_as_much_of_their_folders_as_differs(
    experiments: list[Path], tmp_path: Path
) -> None:
    run = open_run(shutil.copytree(experiments[0], tmp_path / "again") / "naive")
    last = f"naive@{run.path.name}"
    assert _method_of(run, set()) == "naive"
    assert _method_of(run, {"naive"}) == last
    assert _method_of(run, {"naive", last}) == f"naive@again_{run.path.name}"
    table = read_json(export_results([experiments[0], tmp_path / "again"], tmp_path / "out", QUIET))
    assert sorted(row["id"] for row in table["methods"]) == ["naive", "naive@naive", "oracle", "oracle@oracle"]
