"""Claims about the division of scenes into splits."""

from typing import Any

import pytest

from novags.testbed.dataset.file import DatasetConfig
from novags.testbed.dataset.splits import splits_of

SCENES = [f"{name}:{number}" for name in ("tabletop", "cornell", "studio", "hall", "street") for number in range(4)]


def config(**settings: Any) -> DatasetConfig:
    return DatasetConfig(name="dark", licence="CC0-1.0", **settings)


def test_no_scene_lies_in_two_splits_and_shares_are_kept() -> None:
    found = splits_of(SCENES, config(split={"train": 0.6, "val": 0.2, "test": 0.2}))
    by_scene = {name: {found[f"{name}:{k}"] for k in range(4)} for name in ("tabletop", "cornell", "studio", "hall")}
    assert all(len(splits) == 1 for splits in by_scene.values())
    assert sorted(found.values()) == ["test"] * 4 + ["train"] * 12 + ["val"] * 4
    apart = splits_of(SCENES, config(split_by="variation"))
    assert sorted(apart.values()) == ["test"] * 2 + ["train"] * 16 + ["val"] * 2
    assert splits_of(SCENES[::-1], config(split_by="variation")) == apart
    assert splits_of(SCENES, config(split_by="variation", seed=1)) != apart


def test_lists_decide_and_the_rest_is_dealt_out() -> None:
    found = splits_of(SCENES, config(split={"train": 2, "val": 1, "test": ["hall", "street"]}))
    assert {scene for scene, split in found.items() if split == "test"} == set(SCENES[12:])
    assert sorted(found.values())[8:] == ["train"] * 8 + ["val"] * 4


WRONG_SPLITS = {
    "twice": ({"train": ["hall"], "val": ["hall:2"]}, r"\[dataset.split\] val: hall lies in train already"),
    "unknown": ({"train": 1, "test": ["attic"]}, r"test: \[grid\] has no scene 'attic' \(it has tabletop, cornell"),
    "left over": ({"test": ["hall"]}, "lie in no split: name them in a list, or give a share"),
    "share": ({"train": -1}, "train: it must be a share > 0 and at most 1e.09, or a list of scenes, got -1"),
    "huge": (
        {"train": 1e308, "val": 1e308},
        "train: it must be a share > 0 and at most 1e.09, or a list of scenes, got 1e",
    ),
    "digits": ({"train": 10**400}, "train: it must be a share > 0 and at most 1e.09, or a list of scenes, got 100"),
    "text": ({"train": "most"}, "train: it must be a share > 0 and at most 1e.09, or a list of scenes, got 'most'"),
}


@pytest.mark.parametrize("what", WRONG_SPLITS)
def test_splits_that_cannot_be_are_refused(what: str) -> None:
    split, said = WRONG_SPLITS[what]
    with pytest.raises(ValueError, match=said):
        splits_of(SCENES, config(split=split))


def test_a_split_that_would_be_empty_says_what_helps() -> None:
    with pytest.raises(ValueError, match=r'nothing is left for it of 1 scenes: .* split_by = "variation" divides'):
        splits_of(["tabletop:0", "tabletop:1", "tabletop:2"], config())


def test_each_small_share_gets_a_scene_of_the_largest() -> None:
    found = splits_of(SCENES, config(split={"train": 98, "val": 1, "test": 1}, split_by="variation"))
    assert sorted(found.values()) == ["test"] + ["train"] * 18 + ["val"]
    found = splits_of(SCENES, config(split={"train": 1, "val": 1, "test": 98}, split_by="variation"))
    assert sorted(found.values()) == ["test"] * 18 + ["train"] + ["val"]


def test_the_order_follows_from_the_seed_and_the_name() -> None:
    drawn = [splits_of(SCENES, config(split_by="variation", seed=seed)) for seed in (0, 1, 0)]
    assert drawn[0] == drawn[2] != drawn[1]
