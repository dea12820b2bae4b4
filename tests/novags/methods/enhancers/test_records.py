"""Enhancers by name, and their records."""

from types import SimpleNamespace

import pytest
import torch

from novags.methods import enhancers
from novags.methods.enhancers import enhancement_record, located, recorded
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import EnhanceParams, typical

CONFIG = EnhanceConfig(window=5)


def test_typical_parameters_are_the_mean_of_both():
    params = [
        EnhanceParams(gamma=torch.tensor(g), epsilon=torch.tensor(e), radius=4) for g, e in ((0.2, 0.01), (0.5, 0.04))
    ]
    middle = typical(params)
    assert (float(middle.gamma), float(middle.epsilon)) == pytest.approx((0.35, 0.025))
    assert middle.radius == 4


def test_a_record_says_enough_to_enhance_again():
    record = enhancement_record(CONFIG, "16bit")
    assert (record["enhancer"], record["pictures"], record["config"]["window"]) == ("guided", "16bit", 5)
    enhancer, config = recorded(record)
    assert enhancer is enhancers.ENHANCERS["guided"]
    assert config == CONFIG


@pytest.mark.parametrize(
    ("change", "match"), [({"enhancer": "none such"}, "unknown enhancer"), ({"config": {"sigma": 1}}, "run it again")]
)
def test_records_of_other_enhancers_or_versions_are_refused(change, match):
    with pytest.raises(ValueError, match=match):
        recorded({**enhancement_record(CONFIG, "8bit"), **change})


def test_every_file_of_a_record_is_found_where_the_run_lies(tmp_path):
    recorded_as = {"name": "any", "config": {"weights": ["first.pt", "second.pt"], "gain": 2.0}, "pictures": "8bit"}
    there = located(recorded_as, tmp_path)
    assert there["config"] == {"weights": [f"{tmp_path}/first.pt", f"{tmp_path}/second.pt"], "gain": 2.0}
    assert there["pictures"] == "8bit"


def test_a_configuration_of_no_enhancer_is_refused():
    with pytest.raises(ValueError, match="no enhancer has a configuration like SimpleNamespace"):
        enhancement_record(SimpleNamespace(), "8bit")
