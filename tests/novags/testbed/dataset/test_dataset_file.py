"""Claims about the file of a data set: what it means, and that every mistake is one line."""

import re
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.dataset.file import read_dataset
from novags.testbed.dataset.make import splits
from novags.testbed.dataset.recipes.recipe import groups_of
from novags.testbed.study.plan import plan_of

FILE = """
[dataset]
name = "dark"
licence = "CC-BY-4.0"
[grid]
scene = ["tabletop:2..4", "cornell"]
electrons = [5, 20]
"""
MOSAIC = FILE.replace("licence", "recipes=['dark3r']\nlicence") + "sensor = ['a7s2-iso6400']\n"


def test_a_recipe_takes_all_light_levels_of_a_scene_and_camera(tmp_path: Path) -> None:
    (tmp_path / "data.toml").write_text(f"{MOSAIC}seed = [0, 1]\n")
    study, config = read_dataset(tmp_path / "data.toml")
    assert config.recipes == ("dark3r",)
    groups = groups_of(cell.preset for cell in study.cells)
    assert [sorted(preset.capture.electrons for preset in group) for group in groups] == [[5, 20]] * 8


def test_every_combination_is_a_capture_and_sets_are_shared(tmp_path: Path) -> None:
    (tmp_path / "data.toml").write_text(FILE)
    study, config = read_dataset(tmp_path / "data.toml")
    scenes = ("tabletop:2", "tabletop:3", "tabletop:4", "cornell")
    assert study.axes == {"scene": scenes, "electrons": (5, 20), "seed": (0,)}
    assert (config.name, config.split_by, config.shard_mb) == ("dark", "scene", None)
    plan = plan_of(study, tmp_path / "store", Console(quiet=True))
    kinds = [task.kind for task in plan.tasks.values()]
    assert {kind: kinds.count(kind) for kind in kinds} == {"set": 4, "capture": 8}
    assert {plan.tasks[key].kind for key in plan.ends} == {"capture"}


def test_noise_differs_between_captures_and_follows_from_what_they_are(tmp_path: Path) -> None:
    def drawn(text: str) -> dict[str, int]:
        (tmp_path / "data.toml").write_text(text)
        cells = read_dataset(tmp_path / "data.toml")[0].cells
        assert all(cell.preset.capture.seed == cell.values["seed"] for cell in cells)
        return {cell.label: cell.preset.capture.noise_seed for cell in cells}

    first = drawn(f"{FILE}seed = [0, 1]\n")
    assert len(set(first.values())) == len(first) == 16
    assert all(0 <= seed < 2**53 for seed in first.values())
    second = drawn(f'{FILE}seed = [1]\nsensor = ["imx900-hcg"]\n')
    assert not set(first.values()) & set(second.values())
    assert drawn(f"{FILE}seed = [1, 0]\n".replace("2..4", "2..3")).items() <= first.items()


def test_splits_take_any_spelling_of_a_scene(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text("<scene version='3.0.0'/>")
    text = FILE.replace('"cornell"', '"cornell:00", "./a.xml"').replace("2..4", "0..2")
    split = "[dataset.split]\ntrain = 1\nval = ['tabletop:02']\ntest = ['cornell', '../{}/a.xml', 'tabletop:00']"
    by = text.replace("licence", "split_by = 'variation'\nlicence")
    (tmp_path / "data.toml").write_text(by + split.format(tmp_path.name))
    found = splits(*read_dataset(tmp_path / "data.toml"))
    assert found == {"tabletop": "test", "tabletop:1": "train", "tabletop:2": "val", "cornell": "test", "a.xml": "test"}


WRONG = {
    "no table": ("[grid]\nseed=0", "[dataset] is missing"),
    "no licence": ("[dataset]\nname='a'", "[dataset] needs licence"),
    "key": ("[dataset]\nname='a'\nlicense='x'", "[dataset] has no setting 'license'; did you mean 'licence'?"),
    "name": (FILE.replace('"dark"', '"a b"'), "[dataset] name must be letters"),
    "split": (f"{FILE}[dataset.split]\ntrian = 1", "[dataset.split] must be a table of train, val, test"),
    "shards": (FILE.replace("licence", "shard_mb=0\nlicence"), "[dataset] shard_mb must be > 0 and at most"),
    "large shards": (FILE.replace("licence", "shard_mb=1e30\nlicence"), "at most 1e+06, got 1e+30"),
    "seed": (FILE.replace("licence", "seed=-1\nlicence"), "[dataset] seed must be >= 0 and < 2**64, got -1"),
    "date": (FILE.replace("licence", "date='May'\nlicence"), "[dataset] date must be YYYY-MM-DD"),
    "method": (f"{FILE}method='naive'", "[grid] method: it belongs to reconstructions"),
    "points": (f"{FILE}[override]\npoints=9", "[override] points: it belongs to reconstructions"),
    "setting": (f"{FILE}fit.sh_degree=1", "[grid] fit.sh_degree: it is a setting of methods"),
    "size": (
        f"{FILE}[override]\nmax_size=56",
        "max_size = 56 would make dark pictures smaller",
    ),
    "rig": (f"{FILE}rig='a'\n[rig.a]\niterations=3", "[rig.a] iterations: it belongs to reconstructions"),
    "variant": (f"{FILE}[variant.a]\nmethod='naive'", "[variant]: a data set has no methods"),
    "photographs": (FILE.replace('"cornell"', '"photos"'), "a data set is of rendered scenes"),
    "photographs first": (
        FILE.replace("tabletop:2..4", "photos").replace("[5, 20]", "[5]"),
        "scene photos, electrons 5, seed 0: a data set is of rendered scenes",
    ),
    "range": (FILE.replace("2..4", "4..2"), "[grid] scene: 'tabletop:4..2' must be NAME:FIRST..LAST"),
    "scene twice": (FILE.replace('"cornell"', '"tabletop:04"'), "'tabletop:4' is listed twice, also as 'tabletop:04'"),
    "scene of a split": (f"{FILE}[dataset.split]\ntrain = 1\ntest = ['attic']", "test: no scene 'attic'"),
    "recipe": (FILE.replace("licence", "recipes=['denoise']\nlicence"), "recipes: there is no 'denoise'; there are "),
    "recipe twice": (
        FILE.replace("licence", "recipes=['dark3r', 'dark3r']\nlicence"),
        "recipes must differ, got dark3r",
    ),
    "three chips": (
        MOSAIC.replace("a7s2-iso6400", "a7s2-iso6400-3chip"),
        "recipe dark3r, scene tabletop:2: the sensor "
        "must have a colour filter array, which is packed, got a7s2-iso6400-3chip with three chips",
    ),
    "one light": (MOSAIC.replace("[5, 20]", "[5]"), "electrons must have two values or more for each scene and camera"),
    "odd size": (
        f"{MOSAIC}[override]\nwidth=33",
        "width and height must be even for a mosaic, whose cells are 2 x 2 px, got 33 x ",
    ),
    "few views": (
        f"{MOSAIC.replace('dark3r', 'feedforward')}[override]\nviews=3",
        "views must be >= 4, so that every view has two others as context, got 3",
    ),
    "uneven views": (
        f"{MOSAIC}[override]\ncapture.bracket=2.0",
        "views must be exposed alike: leave out exposure_spread, white_balance_spread and bracket",
    ),
    "study's": (f"{FILE}[override]\nspps=3", "[override] spps: there is no such key"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_is_one_line_with_the_file_and_the_key(tmp_path: Path, what: str) -> None:
    text, said = WRONG[what]
    (tmp_path / "photos").mkdir()
    (tmp_path / "data.toml").write_text(text)
    file = re.escape(str(tmp_path / "data.toml"))
    with pytest.raises(ValueError, match=rf"^{file}[^\n]*{re.escape(said)}[^\n]*$"):
        read_dataset(tmp_path / "data.toml")
