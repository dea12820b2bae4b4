"""Claims about stated needs: every word counts, for its kind or for all."""

import pytest

from novags.testbed.study.engines.needs import KINDS, Needs, fits, read_needs, resources


def test_every_word_counts_for_the_kind_that_it_names_or_for_all() -> None:
    found = read_needs(["cpus=2", "run:gpus=0.5,memory=8GB", "set:cpus=4,memory=500MB"])
    assert set(found) == set(KINDS)
    assert found["run"] == Needs(2, 0.5, 8e9)
    assert found["set"] == Needs(4, 0.0, 5e8)
    assert {found[kind] for kind in set(KINDS) - {"run", "set"}} == {Needs(2)}
    assert resources(found["run"]) == {"CPU": 2.0, "GPU": 0.5, "memory": 8e9}
    assert resources(Needs(3)) == {"CPU": 3.0, "GPU": 0.0}


@pytest.mark.parametrize("wrong", ["cpus=0", "picture:cpus=1", "gpus=1.5", "cpus=1GB", "cpus=2,disk=3"])
def test_a_wrong_word_is_refused_wherever_it_stands(wrong: str) -> None:
    with pytest.raises(ValueError, match="needs: "):
        read_needs(["cpus=2", wrong])


@pytest.mark.parametrize("lacking", ["CPU", "GPU", "memory"])
def test_a_task_fits_where_all_that_it_asks_for_is(lacking: str) -> None:
    node = {"CPU": 4.0, "GPU": 1.0, "memory": 1e9}
    asked = {"CPU": 4.0, "GPU": 0.5, "memory": 1e9}
    assert fits(asked, node)
    assert not fits(asked, node | {lacking: 0.1})
