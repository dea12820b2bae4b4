"""Gaussians whose renders lose their noise: the recursion against a slow version, and their files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.rivals.denoised_scene import FILE, STAGES, DenoisedScene, StagedDenoiser, with_denoiser
from novags.splats import Gaussians, rasterize


def trained(width: int = 5) -> StagedDenoiser:
    """Networks that do something."""
    torch.manual_seed(3)
    denoiser = StagedDenoiser(width).requires_grad_(False)
    for parameter in denoiser.parameters():
        parameter.copy_(0.3 * torch.randn(parameter.shape))
    return denoiser


def scene(inputs: Problem) -> DenoisedScene:
    """The wall of a problem, with noise."""
    points = inputs.start.points
    g = torch.Generator().manual_seed(5)
    wall = Gaussians.from_points(points, torch.rand(len(points), 3, generator=g), sh_degree=1)
    return DenoisedScene(GaussianScene(wall, 0.1, True), 0.2 * torch.randn(len(points), 3, generator=g), trained())


def convolved(planes: np.ndarray, weight: np.ndarray, bias: np.ndarray | None) -> np.ndarray:
    """A 3 x 3 correlation with zeros beyond the border: [I, H, W], [O, I, 3, 3] -> [O, H, W]."""
    _, height, width = planes.shape
    wide = np.pad(planes, ((0, 0), (1, 1), (1, 1)))
    out = np.zeros((len(weight), height, width))
    for o, y, x in np.ndindex(out.shape):
        out[o, y, x] = (weight[o] * wide[:, y : y + 3, x : x + 3]).sum() + (0 if bias is None else bias[o])
    return out


def test_the_noise_is_refined_stage_by_stage() -> None:
    denoiser = trained()
    weights = {name: value.double().numpy() for name, value in denoiser.state_dict().items()}
    noise = np.random.default_rng(4).normal(size=(4, 6, 3)).astype(np.float32)
    want = noise.transpose(2, 0, 1).astype(float)
    for k in range(STAGES):

        def layer(planes: np.ndarray, name: str, k: int = k) -> np.ndarray:
            key = f"stages.{k}.{name}"
            return convolved(planes, weights[f"{key}.weight"], weights.get(f"{key}.bias"))

        seen = np.maximum(layer(want, "inner"), 0)
        want = want + layer(seen + np.maximum(layer(seen, "middle"), 0), "outer")
    found = denoiser(torch.from_numpy(noise)).numpy()
    np.testing.assert_allclose(found, want.transpose(1, 2, 0), rtol=1e-4, atol=1e-4)


def test_networks_change_nothing_before_they_have_learned() -> None:
    noise = torch.randn(5, 7, 3, generator=torch.Generator().manual_seed(1))
    assert torch.equal(StagedDenoiser(8)(noise), noise)


def test_the_refined_noise_is_taken_from_the_picture(problem: Callable[..., Problem]) -> None:
    inputs = problem()
    shown, made = inputs.views, scene(inputs)
    g = made.base.gaussians
    colors, alpha, depth = made.base.render(shown)
    noise, _, _ = rasterize(
        g.means, g.quats, g.scales, g.opacities, made.noise, shown.viewmats, shown.Ks, shown.width, shown.height,
        eps2d=0.1, rasterize_mode="antialiased",
    )  # fmt: skip
    found = made.render(shown)
    for view in range(len(colors)):
        want = (colors[view] - made.denoiser(noise[view])).clamp(0, 1)
        torch.testing.assert_close(found[0][view], want)
    assert torch.equal(found[1], alpha)
    assert torch.equal(found[2], depth)


def test_a_saved_scene_is_read_back(problem: Callable[..., Problem], tmp_path: Path) -> None:
    inputs = problem()
    made = scene(inputs)
    made.save(tmp_path)
    found = with_denoiser(made.base, tmp_path)
    assert isinstance(found, DenoisedScene)
    assert torch.equal(found.render(inputs.views)[0], made.render(inputs.views)[0])
    assert made.facts()["denoiser"] == {"parameters": 3 * (5 * 28 + 5 * 46 + 3 * 45)}
    (tmp_path / FILE).unlink()
    assert with_denoiser(made.base, tmp_path) is made.base


@pytest.mark.parametrize("damage", ["cut", "other", "nan", "lacking", "shape"])
def test_damaged_files_are_refused(damage: str, problem: Callable[..., Problem], tmp_path: Path) -> None:
    made, path = scene(problem()), tmp_path / FILE
    made.save(tmp_path)
    tensors = load_file(path)
    if damage == "other":
        tensors["noise"] = tensors["noise"][1:].clone()
    elif damage == "nan":
        tensors["noise"][3, 1] = torch.nan
    elif damage == "lacking":
        del tensors["stages.2.outer.weight"]
    elif damage == "shape":
        tensors["stages.1.outer.weight"] = torch.zeros(2, 2)
    save_file(tensors, path)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match=r"denoiser\.safetensors is not the denoiser of this scene .*reconstruct"):
        with_denoiser(made.base, tmp_path)
