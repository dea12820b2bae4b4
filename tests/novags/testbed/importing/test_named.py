"""Claims about scenes of data sets that a study names: all that fit, and every data set that is not there."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.importing.published import named
from novags.testbed.importing.published.named import DATA, DATASETS, DataFolder

FIRST, SECOND, *_ = DATASETS
SCENES = {f"{FIRST}/bike": 1, f"{FIRST}/bus": 2, f"{SECOND}/bike": 3, f"{FIRST}/chair": 4}


@pytest.fixture
def folder(tmp_path: Path) -> Any:
    """Of the first two data sets."""
    return replace(DataFolder(), root=tmp_path, scenes=dict.fromkeys(SCENES, tmp_path))


def test_a_pattern_stands_for_all_scenes_of_its_data_set_that_fit(folder: Any) -> None:
    assert folder.matching(f"{DATA}{FIRST}/b*") == [f"{DATA}{FIRST}/bike", f"{DATA}{FIRST}/bus"]
    assert folder.matching(f"{DATA}{FIRST.lower()}/CHAIR") == [f"{DATA}{FIRST}/chair"]
    assert folder.matching(f"{DATA}{SECOND}/*") == [f"{DATA}{SECOND}/bike"]
    assert folder.matching("tabletop:1") == ["tabletop:1"]
    with pytest.raises(ValueError, match="did you mean"):
        folder.matching(f"{DATA}{FIRST}/chairs")


def test_every_named_data_set_that_is_not_there_is_told_and_no_other(folder: Any) -> None:
    others = [name for name in DATASETS if name not in (FIRST, SECOND)]
    assert others
    assert folder.absent([f"{DATA}{SECOND}/bike", f"{DATA}{others[0].lower()}/x"]) == others[:1]
    assert folder.absent([f"{DATA}{name}/x" for name in DATASETS]) == others
    assert folder.absent(["tabletop", f"{DATA}{FIRST}/*"]) == []
    for name in SCENES:  # one scene is enough
        assert FIRST not in replace(folder, scenes={name: folder.root}).absent([f"{DATA}{name.partition('/')[0]}/*"])
    with pytest.raises(ValueError, match="no scene begins with"):
        folder.absent(["tabletop"])
    message = named.expected(others[:1] + [FIRST])
    assert all(name in message for name in (others[0], FIRST))
