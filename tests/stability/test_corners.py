"""Every scene, camera, level and method at the corners of their ranges, any two together, end to end."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from novags.cameras import parse_cameras
from novags.methods import METHODS, chosen, names
from novags.methods.enhancers import network_of
from novags.methods.gaussian_scene import GaussianScene
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import read_json
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes import SCENES, read_exr

Row = dict[str, Any]
QUIET = Console(quiet=True)

# They take the true cameras alone, which not every row has.
FOLLOW_TRUTH = tuple(name for name in names() if METHODS[chosen(name).method].sees_surface)
# Their networks have no weights that come with the project.
NEED_FILES = tuple(
    name
    for name in names()
    if (kind := network_of(getattr(METHODS[chosen(name).method].config(), "enhance", None))) is not None
    and kind.rehearsal is None
)
COLUMNS: dict[str, Sequence[Any]] = {
    "scene": tuple(SCENES),
    "method": tuple(name for name in names() if name not in (*FOLLOW_TRUTH, *NEED_FILES)),
    # no noise; the noisiest and the cleanest of a family; one, two and four colours per filter; three chips and mosaics
    "sensor": (
        "ideal", "ideal-3chip", "a7s2-iso100", "a7s2-iso25600-3chip", "imx385-iso25600", "imx686-iso800",
        "imx900-lcg-3chip", "d850-iso6400",
    ),
    "electrons": (0.05, 2.0, 1e6),
    "time": (1e-4, 30.0),
    "jpeg_quality": (None, 1),
    "tolerance": (None, 0.05),
    "pictures": ("8bit", "16bit"),
    "cameras": ("known", "known:rotation_deg=5,translation=0.2,depth_error=0.5"),
    "refine_cameras": (False, True),
    "points": (4, 60),
    "iterations": (0, 12),
    "seed": (0, 2**31 - 1),
}  # fmt: skip


def pairs(row: Row) -> set[tuple[tuple[str, Any], ...]]:
    return set(itertools.combinations(row.items(), 2))


def covering(columns: Mapping[str, Sequence[Any]]) -> list[Row]:
    """Rows in which any two values of two columns meet at least once, by the greedy choice of each next value."""
    places = list(columns.items())
    open_pairs = {
        ((a, x), (b, y)) for (a, xs), (b, ys) in itertools.combinations(places, 2) for x in xs for y in ys
    }  # fmt: skip
    rows: list[Row] = []
    while open_pairs:
        (a, x), (b, y) = min(open_pairs, key=repr)
        row = {a: x, b: y}
        for name, values in places:
            if name not in row:
                # of equally good values another one each time
                turned = [values[(i + len(rows)) % len(values)] for i in range(len(values))]
                row[name] = max(turned, key=lambda v, n=name, r=row: gain(r, n, v, columns, open_pairs))
        row = {name: row[name] for name in columns}
        open_pairs -= pairs(row)
        rows.append(row)
    return rows


def gain(row: Row, name: str, value: Any, columns: Mapping[str, Sequence[Any]], open_pairs: set[Any]) -> int:
    order = list(columns)
    met = ((other, row[other]) for other in row)
    return sum(
        tuple(sorted(((name, value), pair), key=lambda item: order.index(item[0]))) in open_pairs for pair in met
    )


ROWS = covering(COLUMNS)


def test_any_two_values_meet() -> None:
    met = set().union(*map(pairs, ROWS))
    for (a, xs), (b, ys) in itertools.combinations(COLUMNS.items(), 2):
        assert all(((a, x), (b, y)) in met for x in xs for y in ys), (a, b)
    assert len(ROWS) < 1.5 * len(COLUMNS["scene"]) * len(COLUMNS["method"])


def run(row: Row, sets: Path, here: Path) -> Path:
    """The run of a row, in `here`; the sets are shared."""
    few = list(SCENES).index(row["scene"]) % 2
    preset = adapted(
        EXPERIMENTS["demo"], scene=row["scene"], n_views=3 if few else 9, width=29, height=23, spp=2,
        sensor=row["sensor"], electrons=row["electrons"], methods=(row["method"],), pictures=row["pictures"],
        cameras=parse_cameras(row["cameras"]), refine_cameras=row["refine_cameras"], points=row["points"],
        iterations=row["iterations"], denoiser_steps=2,
    )  # fmt: skip
    stages.render(sets / row["scene"], preset.render, QUIET)
    capture = replace(
        preset.capture, time=row["time"], jpeg_quality=row["jpeg_quality"], tolerance=row["tolerance"],
        seed=row["seed"],
    )  # fmt: skip
    stages.capture(sets / row["scene"], here / "capture", capture, QUIET)
    config = replace(preset.reconstruct(row["method"]), seed=row["seed"])
    stages.reconstruct(here / "capture", here / "run", config, QUIET)
    stages.score(here / "run", QUIET)
    return here / "run"


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [n for v in value.values() for n in numbers(v)]
    if isinstance(value, list):
        return [n for v in value for n in numbers(v)]
    return [value] if isinstance(value, float) else []


def outcome(row: Row, sets: Path, here: Path) -> str:
    """The word finite, the line that refuses, or what is not finite."""
    try:
        made = run(row, sets, here)
    except ValueError as refused:
        return f"refused: {refused}" if "\n" not in str(refused) else f"more than a line: {refused}"
    for picture in made.glob("exr/*.exr"):
        for name, channel in read_exr(picture)[0].items():
            if not np.isfinite(channel).all():
                return f"{picture.name}, {name}"
    for record in ("run.json", "metrics.json"):
        if not all(map(math.isfinite, numbers(read_json(made / record)))):
            return record
    return "finite"


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sets")


CORNELL = [row for row in ROWS if row["scene"] == "cornell"]  # one scene, because rendering takes longest
QUICK = [row for row in CORNELL if row["method"] in ("naive", "naive-l1", "nova-fast")]


# None of these needs to be refused, so that none may be.
@pytest.mark.parametrize("row", QUICK, ids=lambda row: row["method"])
def test_some_corners_come_out_finite(row: Row, sets: Path, tmp_path: Path) -> None:
    assert outcome(row, sets, tmp_path) == "finite"


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['scene']}, {row['method']}, {row['sensor']}")
def test_every_corner_comes_out_finite(row: Row, sets: Path, tmp_path: Path) -> None:
    assert outcome(row, sets, tmp_path) == "finite"


@pytest.mark.slow
@pytest.mark.parametrize("name", FOLLOW_TRUTH)
@pytest.mark.parametrize("row", ROWS[::4], ids=lambda row: f"{row['scene']}, {row['sensor']}, {row['electrons']}")
def test_methods_that_follow_the_truth_come_out_finite(name: str, row: Row, sets: Path, tmp_path: Path) -> None:
    assert outcome({**row, "method": name, "cameras": "known"}, sets, tmp_path) == "finite"


def test_a_pixel_that_is_not_finite_is_noticed(sets: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    render = GaussianScene.render

    def broken(self, views):
        image, alpha, depth = render(self, views)
        depth[0, 3, 4] = math.nan
        return image, alpha, depth

    monkeypatch.setattr(GaussianScene, "render", broken)
    row = next(row for row in CORNELL if not row["iterations"])
    assert outcome({**row, "method": "naive", "cameras": "known"}, sets, tmp_path) != "finite"  # a method of Gaussians
