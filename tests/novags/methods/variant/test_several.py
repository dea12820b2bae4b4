"""Claims about the mean of several fits: what it is a mean of, what it costs, and where there is none."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from novags.methods import METHODS, chosen, with_variants
from novags.methods.enhanced import enhance_then_fit
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhancers.networks.rows.zero_dce import METHOD as ZERO_DCE
from novags.methods.problem import Problem
from novags.methods.reconstruction import Reconstruction
from novags.methods.variant import Variant, parts_of
from novags.methods.variant.several import MeanScene, places, seed_of, train_several
from novags.splats import FitConfig
from novags.splats.training.config import CameraRefinement
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

CONFIG = EnhancedFitConfig(init_scale=0.7, fit=FitConfig(iterations=40, sh_degree=0, keep_at=(20,)))


def nothing(*_: Any) -> None: ...


def test_it_shows_the_mean_of_fits_that_differ_in_their_random_numbers_alone(problem: Any, tmp_path: Path) -> None:
    inputs = problem()
    said = list[tuple[int, int]]()
    found = train_several(
        METHODS["naive"], inputs, CONFIG, 3, progress=lambda done, total, _: said.append((done, total)),
        checkpoint=tmp_path / "checkpoint.safetensors",
    )  # fmt: skip
    each = [enhance_then_fit.train(replace(inputs, seed=seed_of(inputs.seed, k)), CONFIG) for k in range(3)]
    pictures = [one.render(inputs.views)[0].double() for one in each]
    assert not torch.equal(pictures[0], pictures[1])
    assert not torch.equal(pictures[1], pictures[2])
    torch.testing.assert_close(found.render(inputs.views)[0].double(), sum(pictures) / 3, rtol=0, atol=1e-6)
    assert torch.equal(found.scene.scenes[0].gaussians.means, each[0].scene.gaussians.means)
    along = [one.along[20].render(inputs.views)[0].double() for one in each]
    torch.testing.assert_close(found.along[20].render(inputs.views)[0].double(), sum(along) / 3, rtol=0, atol=1e-6)
    assert list(found.along) == [20]
    assert torch.equal(found.targets, each[0].targets)
    assert said[-1][0] == 120
    assert {total for _, total in said} == {120}
    assert [done for done, _ in said] == sorted(done for done, _ in said)
    assert len(found.losses) == sum(len(one.losses) for one in each)


def test_every_fit_has_a_seed_of_its_own_and_adds_its_losses_and_seconds(problem: Any, tmp_path: Path) -> None:
    def train(inputs: Problem, config: Any, **_: Any) -> Reconstruction:
        seeds.append(inputs.seed)
        count = float(len(seeds))
        return Reconstruction(
            scene=FlatScene(0.1 * count, 1.0, 2.0), space="linear", config=config,
            losses=[{"loss": count}, {"loss": -count}],
            seconds={"enhance": 0.5 * count, "fit": 10 * count} if count < 3 else {"fit": 10 * count},
        )  # fmt: skip

    method, trained = replace(METHODS["naive"], train=train), dict[int, list[int]]()
    for seed in (4, 5):
        seeds = trained[seed] = list[int]()
        inputs = problem(seed=seed)
        found = train_several(method, inputs, CONFIG, 3, progress=nothing, checkpoint=tmp_path / "fit.safetensors")
        assert [entry["loss"] for entry in found.losses] == [1, -1, 2, -2, 3, -3]
        assert found.seconds == {"enhance": 1.5, "fit": 60}
    assert [seeds[0] for seeds in trained.values()] == [4, 5]
    assert len({seed for seeds in trained.values() for seed in seeds}) == 6


def test_an_interrupted_run_keeps_the_fits_that_are_done(problem: Any, tmp_path: Path) -> None:
    inputs, path = problem(), tmp_path / "checkpoint.safetensors"
    whole = train_several(METHODS["naive"], inputs, CONFIG, 2, progress=nothing, checkpoint=tmp_path / "w" / path.name)
    trained = list[int]()

    def stopped(done: int, total: int, _: Any) -> None:
        trained.append(done)
        if done == 60:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_several(METHODS["naive"], inputs, CONFIG, 2, progress=stopped, checkpoint=path)
    before = len(trained)
    found = train_several(METHODS["naive"], inputs, CONFIG, 2, progress=lambda *_: trained.append(0), checkpoint=path)
    assert len(trained) - before < before  # the first fit is not trained again
    assert torch.equal(found.render(inputs.views)[0], whole.render(inputs.views)[0])


@dataclass(frozen=True)
class FlatScene:
    """A scene of one colour, alpha and depth."""

    color: float
    alpha: float
    depth: float

    def render(self, views: Any) -> tuple[Tensor, Tensor, Tensor]:
        image, alpha = torch.full((1, 2, 2, 3), self.color), torch.full((1, 2, 2), self.alpha)
        return image, alpha, torch.full((1, 2, 2), self.depth)

    def save(self, folder: Path) -> None:
        (folder / "flat").write_text(str(self.color))

    def facts(self) -> dict[str, Any]:
        return {"gaussians": int(self.color * 10), "antialiased": True, "near_plane": 0.01}


def test_a_scene_that_sees_nothing_in_a_pixel_has_no_say_in_its_depth(tmp_path: Path) -> None:
    scene = MeanScene([FlatScene(0.2, 1.0, 4.0), FlatScene(0.4, 0.5, 7.0), FlatScene(0.6, 0.0, 0.0)])
    image, alpha, depth = scene.render(None)
    torch.testing.assert_close((image[0, 0, 0, 0], alpha[0, 0, 0], depth[0, 0, 0]),
                               (torch.tensor(0.4), torch.tensor(0.5), torch.tensor(5.0)))  # fmt: skip
    assert not MeanScene([FlatScene(0.5, 0.0, 0.0)] * 2).render(None)[2].any()
    assert scene.facts()["gaussians"] == 12
    assert "antialiased" not in {name for name in scene.facts() if name != "fits"}
    scene.save(tmp_path)
    assert [(place / "flat").read_text() for place in places(tmp_path, 3)] == ["0.2", "0.4", "0.6"]


def test_seeds_of_several_runs_do_not_meet() -> None:
    seeds = [seed_of(seed, k) for seed in range(20) for k in range(20)]
    assert len(set(seeds)) == len(seeds)
    assert [seed_of(seed, 0) for seed in (0, 3, 2**64 - 1)] == [0, 3, 2**64 - 1]


def test_any_name_takes_a_number_of_fits() -> None:
    own = with_variants([Variant(name="mine", method="naive", settings={"init_scale": 0.5})])
    for name, method, settings in (
        ("nova-fast*4", "nova", dict(chosen("nova-fast").settings)), ("mine*4", "naive", {"init_scale": 0.5}),
        ("oracle-x4", "oracle", {}),
    ):  # fmt: skip
        found = chosen(name, own)
        assert (found.method, dict(found.settings), found.fits) == (method, settings, 4)
        assert found.name == name.replace("*", "-x")
        assert found.title.endswith("; the mean of 4 fits")
    like = with_variants([Variant(name="mine-x3", method="naive", settings={"init_scale": 1.0})])
    assert chosen("mine-x3", like).fits == 1


@pytest.mark.parametrize("name", ["naive*0", "naive*1", "naive*100", "naive*2*2", "naive-x1"])
def test_a_number_of_fits_that_has_no_mean_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="NAME\\*3 is the mean of three fits, of 2 to 99, got"):
        chosen(name)


def test_an_unknown_method_is_named_and_not_its_number_of_fits() -> None:
    with pytest.raises(ValueError, match="unknown method 'navie'; did you mean 'naive'"):
        chosen("navie*3")


def test_fits_with_frames_or_enhancers_of_their_own_are_refused_before_any_work() -> None:
    preset = adapted(EXPERIMENTS["demo"], methods=("naive*2",))
    assert preset.methods == ("naive-x2",)
    with pytest.raises(ValueError, match="would refine cameras of its own.*leave fit.refine_cameras out"):
        replace(preset, settings={"fit.refine_cameras": CameraRefinement()})
    with pytest.raises(ValueError, match="would train an enhancing network of its own.*give enhance.weights"):
        adapted(EXPERIMENTS["demo"], methods=("zero-dce-gs*2",))
    assert adapted(EXPERIMENTS["demo"], methods=("zero-dce-gs",)).reconstruct("zero-dce-gs").variant.fits == 1


def test_its_parts_are_counted_through_one_fit_after_another() -> None:
    config = ZERO_DCE.config()
    one = parts_of(ZERO_DCE, config, 1)
    assert one is not None
    assert parts_of(ZERO_DCE, config, 2) == {f"{part} {k}": steps for k in (1, 2) for part, steps in one.items()}
