"""Claims about the pictures of a view: light at the exposures it is compared at, depth in the unit of the truth."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.methods.problem import encode
from novags.testbed.folders.exposures import Exposures
from novags.testbed.report.look import pictures as module
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.pictures import Tile, ViewTiles, _add_geometry, _add_renders, _Tiles, render_note

SHAPE = (4, 5)
LIGHT = {name: np.random.default_rng(k).uniform(0.05, 0.2, (*SHAPE, 3)) for k, name in enumerate("ab")}


@pytest.fixture
def tiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Keeps what is added by its key."""
    found = SimpleNamespace(images=dict[str, np.ndarray](), notes=dict[str, str]())

    def add(self: Any, key: str, label: str, note: str, image: np.ndarray) -> None:
        found.images[key], found.notes[key] = image, note

    monkeypatch.setattr(_Tiles, "add", add)
    found.tiles = _Tiles(Album(tmp_path / "page.html"), "0001")
    return found


def run(name: str, depth_scale: float = 1.0) -> Any:
    depth = np.linspace(1.0, 2.0, 20).reshape(SHAPE)
    return SimpleNamespace(name=name, space="linear", enhancement=None, lacks=None, rendering=lambda _: LIGHT[name],
                           depth=lambda _: (depth / depth_scale, np.ones(SHAPE)), depth_scale=depth_scale)  # fmt: skip


def test_the_light_of_every_run_is_shown_at_the_exposures_of_the_dark_and_of_the_well_lit_pictures(
    tiles: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = {name: run(name) for name in "ab"}
    lit = np.full((*SHAPE, 3), 0.5)
    monkeypatch.setattr(module, "references", lambda *_: {"lit": lit})
    place: Any = SimpleNamespace(
        capture=SimpleNamespace(names=("0000", "0001"), imported=None), lit=None, runs=runs, main="a",
        exposures={"a": Exposures(0.5, 4.0), "b": Exposures(None, 3.0)},
        metrics={"methods": {name: {"views": {}} for name in "ab"}},
    )  # fmt: skip
    _add_renders(tiles.tiles, 1, place, runs, held_out=True)
    assert list(tiles.images) == ["render-a", "render-b", "dark-a", "lit-a", "lit-b", "truth-lit", "error-a", "error-b"]
    for key, name, gain in (("dark-a", "a", 0.5), ("lit-a", "a", 4.0), ("lit-b", "b", 3.0)):
        np.testing.assert_allclose(tiles.images[key], encode(gain * LIGHT[name]), atol=1e-6)
    for name in "ab":
        np.testing.assert_allclose(tiles.images[f"render-{name}"], encode(LIGHT[name]), atol=1e-6)


@pytest.mark.parametrize(("tones", "wanted"), [
    ("one", {"a": "aligned PSNR 21.0 dB", "b": "aligned PSNR 22.0 dB", "c": "not scored, because no truth is known"}),
    ("two", {"a": "tone-aligned PSNR 19.0 dB", "b": "tone-aligned PSNR 18.0 dB"}),
    ("none of b", {"a": "tone-aligned PSNR 19.0 dB", "b": "tone-aligned PSNR 18.0 dB"}),
])  # fmt: skip
def test_captions_name_one_score_of_all_methods_that_compares_them(tones: str, wanted: dict[str, str]) -> None:
    own = {
        "a": {"enhanced": {"aligned_psnr": 21.0}, "lit": {"aligned_psnr": 15.0, "tone_aligned_psnr": 19.0}},
        "b": {"enhanced": {"aligned_psnr": 22.0}, "lit": {"aligned_psnr": 20.0, "tone_aligned_psnr": 18.0}},
    }
    if tones == "none of b":
        del own["b"]["enhanced"]  # as of a method that ends in good light
    methods = {name: {"mean": each, "views": {"0000": each}} for name, each in own.items()}
    place: Any = SimpleNamespace(one_reference=tones == "one", metrics={"methods": methods})
    methods["c"] = {"mean": own["a"], "views": {}}
    assert {name: render_note(place, name, "0000") for name in wanted} == wanted


def test_a_caption_without_a_score_of_all_methods_names_its_own() -> None:
    own = {"a": {"linear": {"linear_psnr": 31.0}}, "b": {"enhanced": {"aligned_psnr": None}}}
    methods = {name: {"mean": each, "views": {"0000": each}} for name, each in own.items()}
    place: Any = SimpleNamespace(one_reference=False, metrics={"methods": methods})
    assert render_note(place, "a", "0000") == "linear PSNR 31.0 dB"
    assert render_note(place, "b", "0000") == "not scored, because the reference shows nothing"


def test_depths_of_all_runs_are_in_the_unit_of_the_truth(tiles: Any) -> None:
    runs = {"a": run("a", 4.0), "b": run("b", 0.5)}
    z = np.linspace(1.0, 2.0, 20).reshape(SHAPE)
    views: Any = SimpleNamespace(geometry=lambda i: None, rig=None)
    rig = SimpleNamespace(Ks=np.eye(3)[None].repeat(2, 0), viewmats=np.eye(4)[None].repeat(2, 0))
    place: Any = SimpleNamespace(
        capture=SimpleNamespace(names=("0000", "0001"), cameras=SimpleNamespace(rig=rig)), main="a", runs=runs,
        lit=SimpleNamespace(scaled=False, views=views, rig=rig, scanned={}),
    )  # fmt: skip
    _add_geometry(tiles.tiles, 1, place, runs)
    np.testing.assert_allclose(tiles.images["depth-a"], tiles.images["depth-b"], atol=1e-6)
    near, far = np.percentile(z, (1, 99))
    assert tiles.notes["depth-a"] == f"depth, {near:.3g} to {far:.3g}"


@pytest.mark.parametrize("first", ["render-a dark", "dark render-a"])
def test_the_pictures_of_every_method_stand_in_its_row_and_all_others_have_a_row(first: str) -> None:
    keys = (f"{first} input-enhanced render-b error-b depth-a normal-b truth-clean depth-true normal-true "
            "truth-lit linear-b lit-b").split()  # fmt: skip
    tiles = tuple(Tile(key, key, "", "", None) for key in keys)  # type: ignore[arg-type]
    rows = {row: [tile and tile.key for tile in own] for row, own in ViewTiles("0000", True, 4, 3, tiles).rows}
    assert rows["a"] == ["render-a", None, "depth-a", None]
    assert rows["b"] == ["render-b", "error-b", None, "normal-b"]
    assert rows["Truth"] == ["truth-clean", None, "depth-true", "normal-true"]
    assert rows["Other truths"] == ["truth-lit"]
    assert sorted(key for own in rows.values() for key in own if key) == sorted(keys)
