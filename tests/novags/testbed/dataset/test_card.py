"""Claims about the data card."""

from typing import Any

import pytest

from novags.testbed.dataset.card import _effects, _size, card
from novags.testbed.dataset.file import DatasetConfig
from novags.testbed.dataset.publish import DatasetEntry
from novags.testbed.ledger.store import Seal
from novags.testbed.study.entry import Task


def entry(kind: str, scene: str, effect: str | None = None) -> DatasetEntry:
    """With one effect that is simulated, and one that is not; None: with all."""
    seal = Seal("key", "", {}, {"seconds": {"render": 1.0}, "peak_bytes": 1, "bytes": 1}, {})
    effects = [{"name": effect, "on": True}, {"name": f"no {effect}", "on": False, "reason": "dark"}]
    record: dict[str, Any] = {"n_views": 4, "seed": 0, "width": 8, "height": 8}
    if effect is not None:
        record["plan"] = {"effects": effects, "bound": 0.1, "unit": "codes"}
    return DatasetEntry(Task(kind, scene, scene, None), scene, "train", {}, seal, {}, record)


@pytest.mark.parametrize(("scenes", "said"), [(["tabletop:1", "cornell"], True), (["cornell", "own/room.xml"], False)])
def test_no_photograph_is_promised_of_scenes_of_the_catalogue_only(scenes: list[str], said: bool) -> None:
    entries = [entry("set", scene) for scene in scenes]
    manifest = {
        "software": {"novags": "0", "mitsuba": "3"}, "seeds": [0], "cost": {"seconds": 2.0, "bytes": 2}
    }  # fmt: skip
    text = card(DatasetConfig(name="dark", licence="CC0-1.0"), entries, manifest)
    assert ("Everything is rendered: no photograph is part of it" in text) == said
    assert "Scenes stand still" in text


def test_the_card_counts_and_names_all_scenes_values_and_effects(finished: Any) -> None:
    text = (finished.out / "README.md").read_text()
    assert "By Jane, Joe." in text
    assert "| train | tabletop:1 | 2 | 6 |\n| val | cornell | 1 | 3 |\n" in text
    assert "| scene | tabletop:1, cornell |\n| seed | 0, 1 |\n| seeds | 0, 1 |\n" in text
    assert "| light | paths, fog 0, fog 1 | glass, lens 0, lens 1 |\n" in text
    assert "It took 10 s of work" in text


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
