"""Claims about the data card."""

import pytest

from novags.testbed.dataset.card import card
from novags.testbed.dataset.file import DatasetConfig
from novags.testbed.dataset.publish import DatasetEntry
from novags.testbed.ledger.store import Seal
from novags.testbed.study.entry import Task


@pytest.mark.parametrize(("scenes", "said"), [(["tabletop:1", "cornell"], True), (["cornell", "own/room.xml"], False)])
def test_no_photograph_is_promised_of_scenes_of_the_catalogue_only(scenes: list[str], said: bool) -> None:
    seal = Seal("key", "", {}, {"seconds": {"render": 1.0}, "peak_bytes": 1, "bytes": 1}, {})
    record = {"n_views": 4, "seed": 0, "width": 8, "height": 8}
    entries = [DatasetEntry(Task("set", s, s, None), s, "train", {}, seal, {}, record) for s in scenes]
    manifest = {
        "software": {"novags": "0", "mitsuba": "3"}, "seeds": [0], "cost": {"seconds": 2.0, "bytes": 2}
    }  # fmt: skip
    text = card(DatasetConfig(name="dark", licence="CC0-1.0"), entries, manifest)
    assert ("Everything is rendered: no photograph is part of it" in text) == said
    assert "Scenes stand still" in text
