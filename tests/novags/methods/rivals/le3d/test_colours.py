"""The colours of LE3D: the network against a slow version, its start, its file, and any number of threads."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.rivals.le3d.colours import (
    FILE,
    ColourNetwork,
    ColourScene,
    seen_from,
    with_colours,
    with_first_colours,
)
from novags.splats import Gaussians
from tests.novags.methods.rivals.le3d.photographed import cameras

COUNT = 300


def coloured(seed: int = 3) -> tuple[Gaussians, ColourNetwork]:
    """Gaussians with features and biases, and a network that uses them."""
    g = torch.Generator().manual_seed(seed)
    found = Gaussians.from_points(
        torch.rand(COUNT, 3, generator=g) - 0.5, torch.rand(COUNT, 3, generator=g), sh_degree=0
    )
    found.features, found.sh = torch.randn(COUNT, 16, generator=g), 0.3 * torch.randn(COUNT, 1, 3, generator=g)
    torch.manual_seed(seed)
    return found, ColourNetwork()


def scene(seed: int = 3) -> ColourScene:
    """The same as a method gives it back."""
    gaussians, network = coloured(seed)
    matrix = torch.tensor([[1.2, -0.1, 0.0], [0.1, 0.9, 0.0], [0.0, 0.3, 0.5]])
    base = GaussianScene(gaussians, 0.1, True, matrix=matrix)
    return ColourScene.of(base, network.requires_grad_(False), torch.tensor([0.0, 0, -3]))


def slowly(gaussians: Gaussians, network: ColourNetwork, center: list[float]) -> np.ndarray:
    """Colours by the definition, Gaussian by Gaussian."""
    assert gaussians.features is not None
    w = {name: value.detach().double().numpy() for name, value in network.named_parameters()}
    found = np.zeros((COUNT, 3))
    for i in range(COUNT):
        away = [float(gaussians.means[i, k]) - center[k] for k in range(3)]
        length = math.sqrt(sum(a * a for a in away))
        inputs = [*gaussians.features[i].tolist(), *(a / length for a in away)]
        hidden = [
            max(0.0, float(w["inner.bias"][h]) + sum(float(w["inner.weight"][h, k]) * x for k, x in enumerate(inputs)))
            for h in range(16)
        ]
        for c in range(3):
            log = sum(float(w["outer.weight"][c, h]) * x for h, x in enumerate(hidden))
            found[i, c] = math.exp(log + float(gaussians.sh[i, 0, c]))
    return found


def test_a_colour_is_what_the_layers_say_of_features_and_direction() -> None:
    gaussians, network = coloured()
    assert sum(p.numel() for p in network.parameters()) == 16 * 19 + 16 + 3 * 16  # no bias at the end
    center = [0.3, -0.2, -2.0]
    assert gaussians.features is not None
    found = seen_from(torch.tensor(center), gaussians.means, gaussians.features, gaussians.sh[:, 0], network)
    np.testing.assert_allclose(found.detach().numpy(), slowly(gaussians, network, center), rtol=1e-5)


def test_the_gradient_of_the_network_is_that_of_finite_differences() -> None:
    gaussians, network = coloured()
    network.double()
    generator = torch.Generator().manual_seed(8)
    features = torch.randn(5, 16, generator=generator).double().requires_grad_()
    directions = torch.nn.functional.normalize(gaussians.means[:5].double(), dim=1).requires_grad_()
    assert torch.autograd.gradcheck(network, (features, directions))
    value = network(features, directions)
    (found,) = torch.autograd.grad(value.square().sum(), network.inner.weight)
    for place in ((0, 0), (3, 17), (15, 18)):
        ends = []
        for step in (1e-6, -1e-6):
            with torch.no_grad():
                network.inner.weight[place] += step
                ends.append(float(network(features, directions).square().sum()))
                network.inner.weight[place] -= step
        assert float(found[place]) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5, abs=1e-9)


def test_first_colours_are_those_asked_for_seen_from_the_middle_of_the_cameras() -> None:
    gaussians, network = coloured()
    colors = torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(9))
    colors[0] = torch.tensor([0.0, -0.3, math.exp(-5) / 2])  # noise below black has no logarithm
    center = torch.tensor([0.1, 0.2, -3])
    with_first_colours(gaussians, colors, network, center, seed=4)
    assert gaussians.features is not None
    assert float(gaussians.features.std()) == pytest.approx(1e-3, rel=0.1)
    found = seen_from(center, gaussians.means, gaussians.features, gaussians.sh[:, 0], network).detach()
    np.testing.assert_allclose(found.numpy(), colors.clamp_min(math.exp(-5)).numpy(), rtol=1e-5)
    first = gaussians.features
    for seed, same in ((4, True), (5, False)):
        with_first_colours(gaussians, colors, network, center, seed)
        assert torch.equal(first, gaussians.features) is same


def test_colours_do_not_depend_on_the_number_of_threads() -> None:
    """Products of so many rows are shared out, and were summed in another order for another number of threads."""
    g = torch.Generator().manual_seed(1)
    network, rows = ColourNetwork(), torch.randn(12_000, 19, generator=g)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            features = rows[:, :16].clone().requires_grad_()
            out = network(features, rows[:, 16:])
            loss = (out * torch.sin(rows[:, :3])).sum(0)[0]
            found.append((out.detach(), *torch.autograd.grad(loss, [features, *network.parameters()])))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


def test_each_view_sees_colours_of_its_own_direction_through_the_matrix() -> None:
    made, views = scene(), cameras()
    found, alpha, depth = made.render(views)
    colors = np.stack([slowly(coloured()[0], made.network, center) for center in views.centers.tolist()])
    assert np.abs(colors[0] - colors[1]).max() > 1e-3
    light = torch.from_numpy(colors).float() @ made.base.matrix.T  # type: ignore[union-attr]
    images, alphas = dataclasses.replace(made.base, matrix=None).splatted(light, views, render_mode="RGB+ED")
    torch.testing.assert_close(found, images[..., :3], rtol=1e-4, atol=1e-5)
    assert torch.equal(alpha, alphas[..., 0])
    assert torch.equal(depth, images[..., 3])


def test_a_saved_scene_is_read_back(tmp_path: Path) -> None:
    made, views = scene(), cameras()
    made.save(tmp_path)
    found = with_colours(made.base, tmp_path)
    assert isinstance(found, ColourScene)
    assert torch.equal(found.render(views)[0], made.render(views)[0])
    assert made.facts()["colours"] == {"parameters": 368}
    assert made.facts()["gaussians"] == COUNT
    # others show the colours seen from the middle
    np.testing.assert_allclose(
        0.28209479 * made.base.gaussians.sh[:, 0].numpy() + 0.5, slowly(coloured()[0], made.network, [0, 0, -3]),
        rtol=1e-4, atol=1e-5,
    )  # fmt: skip
    (tmp_path / FILE).unlink()
    assert with_colours(made.base, tmp_path) is made.base


@pytest.mark.parametrize("damage", ["cut", "other", "nan", "lacking", "shape", "more"])
def test_damaged_files_are_refused(damage: str, tmp_path: Path) -> None:
    made, path = scene(), tmp_path / FILE
    made.save(tmp_path)
    tensors = load_file(path)
    if damage == "other":
        tensors["bias"] = tensors["bias"][1:].clone()
    elif damage == "nan":
        tensors["features"][3, 1] = torch.nan
    elif damage == "lacking":
        del tensors["outer.weight"]
    elif damage == "shape":
        tensors["inner.weight"] = torch.zeros(2, 2)
    elif damage == "more":
        tensors["outer.bias"] = torch.zeros(3)
    save_file(tensors, path)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match=r"colours\.safetensors has not the colours of this scene .*reconstruct"):
        with_colours(made.base, tmp_path)
