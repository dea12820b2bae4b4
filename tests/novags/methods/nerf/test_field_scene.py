"""The methods `nerf` and `nerf-oracle`: what they aim at, and that their scene is the same when it is read again."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from novags.fields.box import box_of
from novags.fields.field import first_field
from novags.fields.layout import FieldLayout
from novags.fields.march import Proposal
from novags.fields.training.config import FieldFitConfig
from novags.methods.enhancers.applying import enhanced, enhanced_clean
from novags.methods.inputs import LacksInput
from novags.methods.light import MeasuredLight
from novags.methods.nerf import clean, fitting, plain
from novags.methods.nerf.config import NerfConfig
from novags.methods.nerf.losses import robust
from novags.methods.nerf.raw import numbers_of
from novags.methods.nerf.scene import FILE, FieldScene, load_field
from novags.methods.nerf.shading import SHADINGS
from novags.methods.problem import Problem
from novags.methods.start import brightened
from novags.splats.views import Views

QUICK = FieldFitConfig(iterations=90, rays=256, samples=12, rate=0.03, layout=FieldLayout(finest=64, log2_rows=12))


def some_scene(shading: str, numbers: dict[str, float]) -> FieldScene:
    rng = np.random.default_rng(0)
    static = 7 if shading in ("retinex", "product") else 0
    field = first_field(FieldLayout(finest=32, log2_rows=10, static=static, viewed=1 if static else 3), 0)
    field.table.uniform_(-1, 1, generator=torch.Generator().manual_seed(1))
    box = box_of(torch.tensor([[0.0, 0.0, -3.0]]), torch.from_numpy(rng.normal(size=(50, 3))))
    return FieldScene(field, box, Proposal(), 8, shading, numbers)


def some_views() -> Views:
    viewmat = torch.eye(4)
    viewmat[2, 3] = 3.0
    K = torch.tensor([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]])
    return Views(viewmat[None], K[None], 16, 16)


@pytest.mark.parametrize("shading", SHADINGS)
def test_a_saved_field_renders_the_same_when_it_is_read(tmp_path: Path, shading: str) -> None:
    numbers = {"unit": 0.3, **{f"m{i}{j}": float(i == j) + 0.1 * j for i in range(3) for j in range(3)}}
    scene = some_scene(shading, numbers)
    scene.save(tmp_path)
    found = load_field(tmp_path)
    assert found is not None
    for one, other in zip(scene.render(some_views()), found.render(some_views()), strict=True):
        assert torch.equal(one, other)
    assert found.facts() == scene.facts()
    numbers_of = [tensor.numel() for tensor in scene.field.tensors().values()]
    assert len(numbers_of) > 2
    facts = scene.facts()["field"]
    assert (facts["parameters"], facts["bytes"]) == (sum(numbers_of), 4 * sum(numbers_of))


def test_a_folder_without_a_field_has_none_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    assert load_field(tmp_path) is None
    some_scene("display", {}).save(tmp_path)
    whole = (tmp_path / FILE).read_bytes()
    for wrong in (whole[:-100], b"", whole.replace(b"display", b"dispaly"), whole.replace(b"finest", b"fniest")):
        (tmp_path / FILE).write_bytes(wrong)
        with pytest.raises(ValueError, match="is not a field of this version"):
            load_field(tmp_path)


def test_light_is_shown_in_its_unit_through_its_matrix() -> None:
    raw = torch.tensor([[[0.0, 0.1, 0.2, 0.3], [0.0, -1.0, 0.0, 1.0]]])
    weights = torch.tensor([[0.25, 0.5]])
    matrix = np.arange(9).reshape(3, 3) / 7
    numbers = {"unit": 2.0, **{f"m{i}{j}": float(matrix[i, j]) for i in range(3) for j in range(3)}}
    expected = 2 * matrix @ (0.25 * np.exp([0.1, 0.2, 0.3]) + 0.5 * np.exp([-1.0, 0.0, 1.0]))
    found = SHADINGS["light"](raw, weights, numbers)[0].numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    noise: Any = None
    data = MeasuredLight(light=raw, noise=noise, white=torch.ones(3), matrix=torch.from_numpy(matrix))
    assert numbers_of(data, 2.0) == numbers
    assert numbers_of(dataclasses.replace(data, matrix=None), 2.0) == {"unit": 2.0}


def test_nerf_learns_the_enhanced_pictures_and_its_ceiling_the_clean_ones(problem: Callable[..., Problem]) -> None:
    seen, config = problem(), NerfConfig(fit=QUICK)
    results = [module.train(seen, config) for module in (plain, clean)]
    for result in results:
        assert result.space == "enhanced"
        assert result.enhancement is not None
        assert result.targets is not None
        image, alpha, depth = result.render(seen.views)
        assert alpha.shape == depth.shape == image.shape[:3]
        spread = ((result.targets - result.targets.mean((0, 1, 2))) ** 2).mean()
        assert float(((image - result.targets) ** 2).mean()) < 0.6 * float(spread)
    dark = enhanced(seen, config.enhance, config.pictures)
    assert torch.equal(results[0].targets, dark)
    assert torch.equal(results[1].targets, enhanced_clean(seen, config.enhance, config.pictures))
    with pytest.raises(LacksInput, match="noise-free exposures"):
        clean.train(problem(with_clean=False), config)


def test_surfaces_at_the_first_points_are_held_to_their_enhanced_colours(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    given, seen = {}, problem()
    colors = torch.rand(seen.start.colors.shape, generator=torch.Generator().manual_seed(2))
    seen = dataclasses.replace(seen, start=dataclasses.replace(seen.start, colors=colors))  # type: ignore[type-var]
    real = fitting.fitted_scene
    monkeypatch.setattr(fitting, "fitted_scene", lambda *args, **more: given.update(more) or real(*args, **more))
    result = plain.train(seen, NerfConfig(fit=dataclasses.replace(QUICK, iterations=1)))
    assert result.targets is not None
    chosen, raw = torch.tensor([7, 0, 31]), torch.randn(3, 4, generator=torch.Generator().manual_seed(3))
    wanted = brightened(colors, seen.srgb8, result.targets)[chosen]
    errors = 1 / (1 + (-raw[:, 1:]).exp()) - wanted
    assert float(given["at_points"](chosen, raw)) == pytest.approx(float(robust(errors)), rel=1e-5)


def test_nerf_answers_to_errors_and_not_to_their_squares(problem: Callable[..., Problem]) -> None:
    seen, fit = problem(), dataclasses.replace(QUICK, distortion=0.0, rays=4096)
    untrained, once = (
        plain.train(seen, NerfConfig(fit=dataclasses.replace(fit, iterations=steps))) for steps in (0, 1)
    )
    errors = untrained.render(seen.views)[0] - untrained.targets
    assert once.losses[0]["loss"] == pytest.approx(
        0.05 * float(errors.abs().mean()), rel=0.3
    )  # its samples are jittered, and half as many


def test_the_seed_of_the_problem_is_that_of_the_field(problem: Callable[..., Problem]) -> None:
    config = NerfConfig(fit=dataclasses.replace(QUICK, iterations=3))
    one, same, other = (plain.train(problem(seed=seed), config) for seed in (4, 4, 5))
    images = [result.render(problem().views)[0] for result in (one, same, other)]
    assert one.config.fit.seed == 4
    assert torch.equal(images[0], images[1])
    assert not torch.equal(images[0], images[2])
