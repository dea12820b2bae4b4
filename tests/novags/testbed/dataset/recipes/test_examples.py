"""What networks train on: every example of docs/datasets.md opens its recipe and learns, or sees, what it should.

Rationale: a recipe that cannot be opened by thirty lines of torch, or whose noise, light or cameras do not belong
together, is of no use. Expected: a denoiser and a student get better, and context views fit their target where its true
depth moves them to, on scenes with edges and texture.
"""

import csv
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from novags.commands.dataset import dataset
from novags.testbed.dataset.file import read_dataset
from novags.testbed.dataset.recipes.listed import RECIPES, check_recipes, size_of
from novags.testbed.study.cells.presets import EXPERIMENTS

ROOT = Path(__file__).resolve().parents[5]
EXAMPLES = {name: ROOT / "docs" / "examples" / f"{name}.py" for name in RECIPES}
MOSAIC = "a7s2-iso6400"
FILE = """
[dataset]
name = "dark-balls"
licence = "CC-BY-4.0"
recipes = ["denoiser", "dark3r", "feedforward"]
[dataset.split]
val = ["two.xml"]
train = 1
[grid]
scene = ["one.xml", "two.xml"]
sensor = ["a7s2-iso6400"]
electrons = [5, 1000]
[override]
views = 6
width = 48
height = 32
spp = 4
render.variant = "scalar"
"""
ROOM = """<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
  </sensor>
  <emitter type="constant"/>
  <shape type="rectangle">
    <transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
      <rgb name="color0" value="{dark}"/><rgb name="color1" value="0.8"/>
      <transform name="to_uv"><scale value="3"/></transform>
    </texture></bsdf></bsdf>
  </shape>
  <shape type="sphere"><float name="radius" value="0.7"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf></shape>
</scene>
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with all recipes."""
    folder = tmp_path_factory.mktemp("recipes")
    (folder / "data.toml").write_text(FILE)
    (folder / "one.xml").write_text(ROOM.format(dark="0.1", color="0.8,0.2,0.1"))
    (folder / "two.xml").write_text(ROOM.format(dark="0.2", color="0.1,0.3,0.8"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("signal.signal", lambda *_: None)  # pytest keeps its own handlers
        dataset(folder / "data.toml", out=folder / "data", workers=1)
    return folder / "data"


def said_by(
    example: str, data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> np.ndarray:
    """The numbers that an example prints, a row for each line."""
    monkeypatch.setattr(sys, "argv", ["example.py", str(data)])
    capsys.readouterr()
    exec(compile(EXAMPLES[example].read_text(encoding="utf-8"), example, "exec"), {"__name__": "__main__"})
    return np.array([[float(number) for number in re.findall(r"\d+\.?\d*", line)]
                     for line in capsys.readouterr().out.splitlines()])  # fmt: skip


def test_every_recipe_has_an_example_of_some_thirty_lines_that_the_page_names() -> None:
    page = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    for name, file in EXAMPLES.items():
        lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
        assert len([line for line in lines if not line.strip().startswith('"""')]) <= 32
        assert f"`{name}`" in page
        assert f"examples/{name}.py" in page


@pytest.mark.parametrize("at", range(3))
def test_every_recipe_is_looked_up_and_every_scene_is_checked_for_it(at: int) -> None:
    names, scenes = ["denoiser", "dark3r", "feedforward"], ["cornell", "busts", "hall"]
    demo = EXPERIMENTS["demo"]
    presets = [replace(demo, render=replace(demo.render, scene=scene), capture=replace(demo.capture, sensor=MOSAIC,
               electrons=electrons)) for scene in scenes for electrons in (5.0, 1000.0)]  # fmt: skip
    check_recipes(names, presets)
    few = [replace(preset, render=replace(preset.render, n_views=3)) if preset.render.scene == scenes[at] else preset
           for preset in presets]  # fmt: skip
    order = [name for name in names if name != "feedforward"]
    order.insert(at, "feedforward")
    with pytest.raises(ValueError, match=f"recipe feedforward, scene {scenes[at]}: views must be >= 4"):
        check_recipes(order, few)
    names[at] = "denoise"
    with pytest.raises(ValueError, match="recipes: there is no 'denoise'; there are denoiser, dark3r, feedforward"):
        check_recipes(names, presets)


def test_a_denoiser_that_trains_on_the_pairs_takes_noise_out_of_another_scene(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = said_by("denoiser", data, monkeypatch, capsys)
    assert len(found) == 30
    epoch, after, before = found[-1]
    assert after < 0.8 * before


def test_a_student_comes_nearer_to_what_its_teacher_sees_in_the_light(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = said_by("dark3r", data, monkeypatch, capsys)
    assert len(found) == 30
    assert found[-1, 1] < 0.7 * found[0, 1]


def test_context_views_fit_their_target_where_its_depth_moves_them(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    light, moved, unmoved = said_by("feedforward", data, monkeypatch, capsys).T
    assert len(light) == 6  # views of the scene for training
    assert np.all(moved < 0.7 * unmoved)
    assert np.all(light > 0)


def test_levels_of_light_and_noise_are_in_the_index(data: Path) -> None:
    with (data / "training" / "dark3r" / "index.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["split"] for row in rows] == ["train"] * 6 + ["val"] * 6
    for row in rows:
        assert row["electrons"] == "5 1000"
        dark, bright = map(float, row["snr_db"].split())
        assert bright - dark > 20  # 200 times the light is 23 dB of shot noise alone


def test_the_disk_of_the_samples_is_forecast_within_a_fifth(data: Path) -> None:
    study, config = read_dataset(data.parent / "data.toml")
    expected = size_of(config.recipes, [cell.preset for cell in study.cells])
    found = sum(path.stat().st_size for path in (data / "training").rglob("*.npz"))
    headers = 700 * 24 + 1400 * 12 + 1400 * 12  # of so small arrays these count
    assert found - headers == pytest.approx(expected, rel=0.2)
