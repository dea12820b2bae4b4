"""Claims about the data card."""

import json
from typing import Any

import pytest

from novags.testbed.dataset.card import _effects, _size, card
from novags.testbed.dataset.file import DatasetConfig
from novags.testbed.dataset.publish import DatasetEntry
from novags.testbed.dataset.recipes.listed import RECIPES
from novags.testbed.ledger.store import Seal
from novags.testbed.study.entry import Task

MANIFEST = {"software": {"novags": "0", "mitsuba": "3"}, "seeds": [0], "cost": {"seconds": 2.0, "bytes": 2}}


def entry(
    kind: str, scene: str, effect: str | None = None, split: str = "train", views: int | None = None
) -> DatasetEntry:
    """With one effect that is simulated, and one that is not; None: with all."""
    seal = Seal("key", "", {}, {"seconds": {"render": 1.0}, "peak_bytes": 1, "bytes": 1}, {})
    effects = [{"name": effect, "on": True}, {"name": f"no {effect}", "on": False, "reason": "dark"}]
    record: dict[str, Any] = {"n_views": 4, "seed": 0, "width": 8, "height": 8}
    if effect is not None:
        record["plan"] = {"effects": effects, "bound": 0.1, "unit": "codes"}
    if views is not None:
        record["views"] = views
    return DatasetEntry(Task(kind, scene, scene, None), scene, split, {}, seal, {}, record)


@pytest.mark.parametrize(("scenes", "said"), [
    (["tabletop:1", "cornell"], True), (["cornell", "own/room.xml"], False), (["own/room.xml", "cornell"], False),
])  # fmt: skip
def test_no_photograph_is_promised_of_scenes_of_the_catalogue_only(scenes: list[str], said: bool) -> None:
    entries = [entry("set", scene) for scene in scenes]
    text = card(DatasetConfig(name="dark", licence="CC0-1.0"), entries, MANIFEST)
    assert ("Everything is rendered: no photograph is part of it" in text) == said
    assert "Scenes stand still" in text


def test_the_card_counts_and_names_all_scenes_values_and_effects(finished: Any) -> None:
    text = (finished.out / "README.md").read_text()
    assert "By Jane, Joe." in text
    assert "| train | tabletop:1 | 2 | 6 |\n| val | cornell | 1 | 3 |\n" in text
    assert "| scene | tabletop:1, cornell |\n| seed | 0, 1 |\n| seeds | 0, 1 |\n" in text
    assert "| light | paths, fog 0, fog 1 | glass, lens 0, lens 1 |\n" in text
    assert "It took 10 s of work" in text


def test_every_capture_counts_its_split_can_be_loaded_and_every_recipe_is_explained() -> None:
    entries = [
        entry("capture", "cornell", split="test", views=600),
        entry("set", "cornell", split="test"),
        entry("capture", "tabletop:1", views=500),
        entry("capture", "own/room.xml", split="val", views=300),
    ]
    recipes = ("denoiser", "dark3r", "feedforward")
    text = card(DatasetConfig(name="dark", licence="CC0-1.0", recipes=recipes), entries, MANIFEST)
    assert "| train | tabletop:1 | 1 | 500 |\n| val | own/room.xml | 1 | 300 |\n| test | cornell | 1 | 600 |\n" in text
    head = dict(line.split(": ", 1) for line in text.split("---\n")[1].splitlines())
    assert json.loads(head["size_categories"]) == ["1K<n<10K"]
    (config,) = json.loads(head["configs"])
    assert [part["split"] for part in config["data_files"]] == ["train", "val", "test"]
    assert "".join(f"- `training/{name}`: {RECIPES[name].what}.\n" for name in recipes) in text


@pytest.mark.parametrize("plans", [(None, "some"), ("some", None), ("some", "other")])
def test_all_effects_are_in_only_if_every_entry_has_all(plans: tuple[str | None, ...]) -> None:
    found = _effects([entry("set", f"s{k}", plan) for k, plan in enumerate(plans)] + [entry("capture", "c", None)])
    given = [plan for plan in plans if plan]
    assert found[2] == f"| light | {', '.join(given)} | {', '.join(f'no {plan}' for plan in given)} |"
    assert found[3] == "| camera | all effects | none |"


@pytest.mark.parametrize(("count", "size"), [(0, "n<1K"), (999, "n<1K"), (1_000, "1K<n<10K"), (10_000, "10K<n<100K"),
                                             (999_999, "100K<n<1M"), (1_000_000, "1M<n<10M")])  # fmt: skip
def test_the_size_is_a_category_of_the_hub(count: int, size: str) -> None:
    assert _size(count) == size
