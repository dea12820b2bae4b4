"""Long runs: 20,000 iterations at two electrons, with the norm of every group of parameters on record."""

import dataclasses
import math
import sys
from itertools import pairwise

import pytest
import torch

from novags.methods import METHODS, chosen
from novags.splats.training.fit import LOG_EVERY
from novags.testbed.study.cells.presets import EXPERIMENTS
from tests.stability.case import Case, Error, Part, Setting
from tests.stability.wall import problem

PART = Part("long_runs")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

ITERATIONS = 20_000
# Largest root mean squares that are still ordinary: log scales and logits of the range that `splats` covers, and
# what Adam can move a quaternion or a colour at its rate in so many iterations; positions in world units.
LARGEST = {"means": 50.0, "quats": 20.0, "log_scales": 40.0, "logit_opacities": 100.0, "sh": 50.0}


def _largest_ratio(name: str) -> float:
    """The largest norm of a group on record over what it may be; infinite where one is missing or not finite."""
    variant = chosen(name)
    config = variant.config(METHODS[variant.method].config(), {"init_scale": 0.7, "fit.rates.schedule": "gsplat"})
    config = dataclasses.replace(config, fit=dataclasses.replace(config.fit, iterations=ITERATIONS, sh_degree=1))
    counts = {"means": 3, "quats": 4, "log_scales": 3, "logit_opacities": 1, "sh": 12}
    records: list[tuple[int, int, dict[str, float]]] = []
    result = METHODS[variant.method].train(problem(), config, progress=lambda *record: records.append(record))
    done, total = [0, *(record[0] for record in records)], {record[1] for record in records}
    steps = [after - before for before, after in pairwise(done)]
    if {done[-1]} != total or not all(0 < step <= LOG_EVERY for step in steps):  # part of it is not on record
        return math.inf
    if not all(math.isfinite(value) for _, _, entry in records for value in entry.values()):
        return math.inf
    entries = [entry for _, _, entry in records if "loss" in entry]
    worst = 0.0
    for group, largest in LARGEST.items():
        sizes = [entry[f"norm_{group}"] / math.sqrt(entry["n_gaussians"] * counts[group]) for entry in entries]
        worst = max(worst, max(sizes) / largest)
    image, alpha, depth = result.render(problem().views)
    finite = all(bool(torch.isfinite(t).all()) for t in (image, alpha, depth))
    return worst if finite else math.inf


for _name in EXPERIMENTS["demo"].methods:
    if not METHODS[chosen(_name).method].sees_clean:  # the wall has no noise-free pictures
        PART.case(
            f"20,000 iterations at two electrons: {_name}", bound=1, unit="of the largest sensible norm",
            backends=("numba",), slow=True,
        )(lambda setting, name=_name: _largest_ratio(name))  # fmt: skip


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_short_run_holds_and_one_that_drifts_or_lacks_its_norms_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HERE, "ITERATIONS", 20)
    case, setting = PART.named("20,000 iterations at two electrons: naive"), Setting("numba")
    assert case.error(setting) <= case.bound
    monkeypatch.setitem(LARGEST, "log_scales", 0.1)
    assert not case.error(setting) <= case.bound
    monkeypatch.setitem(LARGEST, "log_scales", math.inf)
    monkeypatch.setitem(LARGEST, "an unknown group", 1.0)
    with pytest.raises(KeyError, match="norm_an unknown group"):
        case.error(setting)
