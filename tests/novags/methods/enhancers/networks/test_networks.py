"""Where the weights of enhancing networks go, and a training that is interrupted."""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from novags.methods.enhanced.by_enhancer import parts
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhanced.enhance_then_fit import train
from novags.methods.enhancers import ENHANCERS, located, recorded
from novags.methods.enhancers.applying import enhanced, enhanced_like
from novags.methods.enhancers.files.weights import digest_of
from novags.methods.enhancers.networks.kind import Kind, crops, described
from novags.methods.enhancers.networks.rehearsal import learned
from novags.methods.enhancers.networks.rows.sci import SciConfig
from novags.methods.enhancers.networks.rows.zero_dce import ZeroDceConfig
from novags.methods.enhancers.networks.sci import SCI, Sci
from novags.methods.enhancers.networks.zero_dce import ZERO_DCE, ZeroDce
from novags.methods.inputs import LacksInput
from novags.methods.problem import Problem
from novags.splats import FitConfig, Views
from novags.testbed.ledger.contents import jsonable

TINY = ZeroDceConfig(steps=6, batch=1, crop=8, rate=1e-2)


def dark(views: int = 3) -> torch.Tensor:
    return 0.3 * torch.rand(views, 16, 18, 3, generator=torch.Generator().manual_seed(0))


def problem() -> Problem:
    points = torch.rand(30, 3, generator=torch.Generator().manual_seed(1)) + torch.tensor([-0.5, -0.5, 2.0])
    start = SimpleNamespace(points=points, colors=torch.rand(30, 3), extent=1.0)
    K = torch.tensor([[16.0, 0, 9], [0, 16, 8], [0, 0, 1]])
    views = Views(torch.eye(4).repeat(3, 1, 1), K.repeat(3, 1, 1), 18, 16)
    return Problem(views=views, start=start, seed=3, srgb8=dark())


def fitted(enhance: object) -> EnhancedFitConfig:
    return EnhancedFitConfig(enhance=enhance, fit=FitConfig(iterations=2))


def saved(path: Path, network: torch.nn.Module) -> Path:
    torch.save(network.state_dict(), path)
    return path


class Stop(Exception):
    pass


@pytest.mark.parametrize("config", [TINY, SciConfig(steps=6, batch=1, crop=8)], ids=["zero-dce", "sci"])
def test_a_training_that_is_interrupted_goes_on_to_the_same_bits(tmp_path, monkeypatch, config):
    monkeypatch.setattr("novags.methods.enhancers.networks.rehearsal.SAVED", 0.0)
    kind, seen = ZERO_DCE if config is TINY else SCI, []

    def stop(done, total, losses):
        seen.append((done, total))
        time.sleep(0.1)
        if done == 3:
            raise Stop

    whole, earlier = learned(kind, config, dark(), 5)
    assert earlier == 0
    with pytest.raises(Stop):
        learned(kind, config, dark(), 5, progress=stop, more=4, checkpoint=tmp_path / "c.safetensors")
    assert seen == [(1, 10), (2, 10), (3, 10)]
    resumed, earlier = learned(kind, config, dark(), 5, checkpoint=tmp_path / "c.safetensors")
    assert earlier > 0.2  # what the stopped run had spent when it was saved
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name
    other, _ = learned(kind, config, dark(), 6)
    assert not all(torch.equal(v, other.state_dict()[n]) for n, v in whole.state_dict().items())


def test_a_checkpoint_of_another_run_or_a_damaged_one_is_one_line(tmp_path):
    path = tmp_path / "c.safetensors"
    learned(ZERO_DCE, TINY, dark(), 5, checkpoint=path)
    with pytest.raises(ValueError, match="another run|other pictures"):
        learned(ZERO_DCE, TINY, dark() / 2, 5, checkpoint=path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match="damaged"):
        learned(ZERO_DCE, TINY, dark(), 5, checkpoint=path)


def test_a_loss_that_is_not_finite_stops_with_a_line():
    with pytest.raises(ValueError, match="Zero-DCE must be finite.*lower enhance.rate"):
        learned(ZERO_DCE, TINY, torch.full((1, 8, 8, 3), float("nan")), 0)


@pytest.mark.parametrize("name", ["mbllen", "uretinex", "retinexformer", "naka-net"])
def test_networks_that_need_pairs_say_where_weights_come_from(name):
    config = ENHANCERS[name].config()
    assert parts(fitted(config)) == {"fit": 2}
    with pytest.raises(LacksInput, match="set enhance.weights to .* trained here"):
        train(problem(), fitted(config))


def test_what_holds_no_weights_of_the_network_is_one_line(tmp_path):
    (tmp_path / "text.pth").write_text("no weights")
    torch.save(torch.ones(3), tmp_path / "tensor.pth")
    torch.save({"a": 1}, tmp_path / "none.pth")
    torch.save({"a": torch.tensor([float("nan")])}, tmp_path / "nan.pth")
    saved(tmp_path / "sci.pt", Sci())
    for name, words in [("gone.pth", "no weights at"), ("text.pth", "text.pth"), ("tensor.pth", "not tensors by name"),
                        ("none.pth", "no tensors"), ("nan.pth", "a is not finite"),
                        ("sci.pt", "e_conv1.weight of .* another network")]:  # fmt: skip
        with pytest.raises(ValueError, match=words) as refused:
            ZERO_DCE.load(ZeroDceConfig(weights=(tmp_path / name,)))
        assert "\n" not in str(refused.value)
    with pytest.raises(LacksInput, match="Zero-DCE has no weights: set enhance.weights"):
        enhanced(problem(), ZeroDceConfig(), "8bit")


def test_a_file_that_changes_is_read_again(tmp_path):
    config = ZeroDceConfig(weights=(saved(tmp_path / "a.pth", ZeroDce()),))
    first = ZERO_DCE.load(config)
    assert ZERO_DCE.load(config) is first
    (tmp_path / "a.pth").unlink()
    saved(tmp_path / "a.pth", ZeroDce())
    assert ZERO_DCE.load(config) is not first


def test_a_method_learns_from_the_scene_and_its_run_holds_the_network(tmp_path):
    """Rationale: what is scored later is compared with the noise-free exposure through the very same network."""
    config, reports = fitted(TINY), []
    assert parts(config) == {"enhancer": 6, "fit": 2}
    result = train(problem(), config, progress=lambda done, total, entry: reports.append((done, total)))
    assert reports[-1][1] == 8
    assert [done for done, _ in reports] == sorted(done for done, _ in reports)
    wanted, _ = learned(ZERO_DCE, TINY, dark(), 3)
    pictures = torch.stack([ZERO_DCE.picture(wanted, each, TINY)[0] for each in dark()])
    assert torch.equal(result.targets, pictures)
    result.save(tmp_path)
    enhancer, again = recorded(located(jsonable(result.enhancement), tmp_path))
    assert again.weights == (tmp_path / "enhancer.safetensors",)
    assert torch.equal(enhancer.enhance(dark()[1], again, None, None)[0], pictures[1])
    clean = dark()[1] * 0.9
    assert torch.equal(enhanced_like(clean, again, None), ZERO_DCE.picture(wanted, clean, TINY)[0])
    assert result.found == {"enhancer": {"learned_steps": 6}}


def test_a_method_with_given_weights_learns_nothing_and_records_their_digest(tmp_path):
    path = saved(tmp_path / "mine.pt", Sci())
    config = fitted(SciConfig(weights=(path,)))
    assert parts(config) == {"fit": 2}
    result = train(problem(), config)
    assert result.found == {"enhancer": {"files": ["mine.pt"], "digest": digest_of((path,))}}
    (tmp_path / "run").mkdir()
    result.save(tmp_path / "run")
    path.unlink()  # the run needs it no more
    _, again = recorded(located(jsonable(result.enhancement), tmp_path / "run"))
    assert torch.equal(enhanced_like(dark()[0], again, None), result.targets[0])


@pytest.mark.parametrize(
    "change", [{"steps": -1}, {"rate": 0.0}, {"batch": 0}, {"crop": 0}, {"decay": 1.0}, {"rate": float("nan")}]
)
def test_trainings_that_cannot_be_are_refused(change):
    for kind in (ZeroDceConfig, SciConfig):
        with pytest.raises(ValueError, match="must"):
            kind(**change)
    with pytest.raises(ValueError, match="additivity"):
        SciConfig(additivity=-1.0)


def test_the_seed_chooses_the_first_weights_and_every_step_draws_crops_of_its_own():
    seen = []

    def watched(network, pictures, config):
        seen.append(pictures)
        return ZERO_DCE.rehearsal.loss(network, pictures, config)

    kind = replace(ZERO_DCE, rehearsal=replace(ZERO_DCE.rehearsal, loss=watched))
    for seed in (0, 1):
        learned(kind, replace(TINY, steps=3), dark(), seed)
    assert [tuple(batch.shape) for batch in seen] == [(1, 3, 8, 8)] * 6
    assert not any(torch.equal(one, other) for i, one in enumerate(seen) for other in seen[:i])
    first = [learned(ZERO_DCE, replace(TINY, steps=0), dark(), seed)[0].e_conv1.weight for seed in (0, 0, 1)]
    assert torch.equal(first[0], first[1])
    assert not torch.equal(first[0], first[2])


def test_crops_lie_anywhere_inside_any_picture():
    index = torch.arange(2 * 4 * 5).reshape(2, 4, 5, 1)
    pictures, rng, corners = torch.cat([index, index + 100, index + 200], -1), np.random.default_rng(0), set()
    for crop in crops(pictures, 300, 3, rng):
        view, top, left = (int(i) for i in np.unravel_index(int(crop[0, 0, 0]), (2, 4, 5)))
        assert torch.equal(crop, pictures[view, top : top + 3, left : left + 3].movedim(-1, 0))
        corners.add((view, top, left))
    assert corners == {(v, y, x) for v in range(2) for y in range(2) for x in range(3)}
    assert crops(pictures, 1, 9, rng).shape == (1, 3, 4, 4)


def test_a_picture_goes_through_a_network_as_it_lies_and_is_cut_at_white():
    def run(network, picture, config):
        assert picture.shape == (1, 3, 4, 6)
        return picture * torch.tensor([0.5, 1.5, 3.0])[:, None, None] + torch.arange(4)[:, None] / 8

    picture = 0.5 * torch.rand(4, 6, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found, params = replace(ZERO_DCE, run=run).picture(ZeroDce(), picture, TINY)
    expected = (picture * torch.tensor([0.5, 1.5, 3.0]) + torch.arange(4)[:, None, None] / 8).clamp(0, 1)
    assert 3 < (expected == 1).sum() < 30
    assert params is None
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)


def test_no_gradient_of_a_rehearsal_is_longer_than_its_clip() -> None:
    config = replace(TINY, steps=1)
    plain = replace(
        ZERO_DCE.rehearsal, loss=lambda network, batch, config: 1e6 * network(batch)[0].square().mean(), clip=0.1,
        optimizer=lambda network, config: torch.optim.SGD(network.parameters(), lr=1.0),
    )  # fmt: skip
    torch.manual_seed(5)
    before = ZERO_DCE.make(config)
    after, _ = learned(replace(ZERO_DCE, rehearsal=plain), config, dark(), 5)
    moved = [(a - b).detach() for a, b in zip(after.parameters(), before.parameters(), strict=True)]
    assert math.sqrt(sum(float(each.square().sum()) for each in moved)) == pytest.approx(0.1, rel=1e-3)


@dataclass(frozen=True)
class Wide:
    """The settings of a network whose width is a choice."""

    weights: tuple[Path, ...]
    times: float = 1.0


class Times(torch.nn.Module):
    """Makes pictures brighter by a weight and a setting."""

    def __init__(self, times: float) -> None:
        super().__init__()
        self.weight, self.times = torch.nn.Parameter(torch.ones(())), times

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        return picture * self.weight * self.times


TIMES = Kind(
    name="Times", make=lambda config: Times(config.times), run=lambda network, picture, config: network(picture)
)


def test_a_network_that_is_held_in_memory_is_that_of_its_name_and_its_settings(tmp_path):
    config = Wide((saved(tmp_path / "w.pth", Times(1.0)),))
    picture = torch.full((2, 2, 3), 0.1)
    for kind, own, expected in ((TIMES, config, 0.1), (TIMES, replace(config, times=3.0), 0.3), (TIMES, config, 0.1)):
        torch.testing.assert_close(kind.picture(kind.load(own), picture, own)[0], torch.full((2, 2, 3), expected))
    other = replace(TIMES, name="Other", make=lambda config: Times(5.0))
    torch.testing.assert_close(other.picture(other.load(config), picture, config)[0], torch.full((2, 2, 3), 0.5))


def test_a_checkpoint_of_another_network_is_refused_by_its_name(tmp_path):
    path = tmp_path / "c.safetensors"
    learned(ZERO_DCE, TINY, dark(), 5, checkpoint=path)
    for kind, config, seed in ((replace(ZERO_DCE, name="Other"), TINY, 5), (ZERO_DCE, replace(TINY, rate=2e-2), 5),
                               (ZERO_DCE, TINY, 6)):  # fmt: skip
        with pytest.raises(ValueError, match="other pictures or settings"):
            learned(kind, config, dark(), seed, checkpoint=path)


def test_all_files_of_weights_of_a_run_are_looked_for_in_its_folder():
    found = located({"enhancer": "x", "config": {"weights": ["a.h5", "b.h5"], "rate": 1}}, Path("run"))
    assert found == {"enhancer": "x", "config": {"weights": ["run/a.h5", "run/b.h5"], "rate": 1}}


def test_a_record_names_every_file_of_weights(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.pth", "b.pth", "c.pth")]
    for file in files:
        file.write_text(file.name)
    assert described(files)["files"] == ["a.pth", "b.pth", "c.pth"]
    assert described(files)["digest"] != described(files[:1])["digest"]
