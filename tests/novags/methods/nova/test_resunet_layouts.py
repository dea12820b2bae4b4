"""The network's own layers beside torch's, in float32 as a denoiser runs them: values, gradients, optimiser steps."""

import copy
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import FAST_DENOISER, DenoiserConfig, ResUNetConfig
from novags.methods.nova.resunet import FEW, Convolution, InstanceNorm, ResUNet, SqueezeExcite

# 96 px: maps of few pixels at the bottleneck, which take another way, and of many above
WIDE = ResUNetConfig(widths=(8, 16, 24), bottleneck=32)


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[4] / "scripts"))


def views(size: int, count: int = 2) -> Tensor:
    return torch.rand(count, size, size, 3, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    "config",
    [DenoiserConfig(network=WIDE), replace(FAST_DENOISER, crop=48, residual_blur=None), DenoiserConfig()],
    ids=["several pixels at the bottleneck", "fast", "the paper's"],
)
def test_loss_and_gradients_of_a_step_are_those_of_torchs_modules(config):
    from denoising.plain import pair, torchs

    ours, plain = pair(views(96), config)
    losses = [denoiser.loss() for denoiser in (ours, plain)]
    for loss in losses:
        loss.backward()
    torch.testing.assert_close(losses[0], losses[1], rtol=1e-5, atol=0)
    found, wanted = ({name: p.grad for name, p in d.network.named_parameters()} for d in (ours, plain))
    found, wanted = (torch.cat([g.flatten() for g in gradients.values()]) for gradients in (torchs(found), wanted))
    assert (found - wanted).norm() <= 1e-5 * wanted.norm()


def test_steps_are_those_of_torchs_modules_and_optimiser():
    from denoising.plain import pair

    ours, plain = pair(views(40), replace(FAST_DENOISER, crop=32, batch=2))
    losses = [[denoiser.train_step() for _ in range(5)] for denoiser in (ours, plain)]
    assert losses[0] == pytest.approx(losses[1], rel=1e-5)


def test_a_restored_optimiser_goes_on_as_if_never_saved():
    config = replace(FAST_DENOISER, crop=32, batch=2)
    denoiser, other = (Denoiser(views(40), config, total_steps=10, seed=0) for _ in range(2))
    for _ in range(3):
        denoiser.train_step()
    other.restore({name: value.clone() for name, value in denoiser.state().items()})
    assert [denoiser.train_step() for _ in range(3)] == [other.train_step() for _ in range(3)]
    for mine, restored in zip(denoiser.network.parameters(), other.network.parameters(), strict=True):
        assert torch.equal(mine, restored)


@pytest.mark.parametrize("slope", [0.2, 1.0])
@pytest.mark.parametrize(("channels", "size"), [(5, (7, 9)), (40, (16, 10))])
def test_normalisation_and_rectifier_are_torchs_in_values_and_gradients(channels, size, slope):
    generator = torch.Generator().manual_seed(2)
    x = 3 + torch.randn(2, channels, *size, generator=generator)
    x[0, 1], x[1, 2, 3, 4] = 0.3, 50.0  # a constant map, and one with an outlier
    weight = torch.randn(x.shape, generator=generator)
    exact = x.double().requires_grad_()
    (F.leaky_relu(F.instance_norm(exact), slope) * weight).sum().backward()
    found = x.clone().requires_grad_()
    y = InstanceNorm(channels, slope)(found)
    (y * weight).sum().backward()
    wanted = F.leaky_relu(F.instance_norm(exact.detach()), slope)
    wanted[0, 1], exact.grad[0, 1] = 0, 0
    torch.testing.assert_close(y.double(), wanted, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(found.grad.double(), exact.grad, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("slope", [0.2, 1.0])
@pytest.mark.parametrize(("channels", "size"), [(5, (7, 9)), (40, (16, 10))])
def test_normalisation_in_bfloat16_rounds_what_single_precision_has(channels, size, slope):
    generator = torch.Generator().manual_seed(2)
    x, weight = (torch.randn(2, channels, *size, generator=generator).bfloat16() for _ in range(2))
    x[0, 1], x[1, 2, 3, 4] = 0.3, 50.0
    coarse, fine = x.clone().requires_grad_(), x.float().requires_grad_()
    y, wanted = InstanceNorm(channels, slope)(coarse), InstanceNorm(channels, slope)(fine)
    assert y.dtype == torch.bfloat16
    y.backward(weight)
    wanted.backward(weight.float())
    assert torch.equal(y, wanted.bfloat16())
    assert torch.equal(coarse.grad, fine.grad.bfloat16())


def test_the_plain_normalisation_is_the_same():
    x = torch.randn(2, 6, 8, 12, generator=torch.Generator().manual_seed(3))
    x[1, 4] = 1.0
    norm = InstanceNorm(6, 0.2)
    torch.testing.assert_close(norm(x), norm.plain(x), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("value", [torch.nan, -torch.nan, torch.inf])
def test_normalisation_hides_no_number_that_is_not_finite(value, dtype):
    x = torch.ones(1, 3, 4, 4, dtype=dtype)
    x[0, 1, 2, 2] = value
    assert not torch.isfinite(InstanceNorm(3, 0.2)(x)[0, 1]).all()


def test_normalisation_does_not_depend_on_the_number_of_threads():
    x = torch.randn(1, 70, 24, 24, generator=torch.Generator().manual_seed(4))
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            y = x.clone().requires_grad_()
            z = InstanceNorm(70, 0.2)(y)
            z.square().mul(x).sum().backward()
            found.append((z.detach(), y.grad))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


@pytest.mark.parametrize("edge", [1, 3])
@pytest.mark.parametrize("size", [(2, 2), (4, 5), (20, 24)])
def test_convolutions_of_few_and_of_many_pixels_are_torchs(size, edge):
    assert size[0] * size[1] * 2 <= FEW or size == (20, 24)
    from denoising.plain import torchs

    convolution = Convolution(6, 10, edge)
    plain = nn.Conv2d(6, 10, edge, padding=edge // 2, padding_mode="reflect")
    plain.load_state_dict(torchs(convolution.state_dict()))
    x = torch.randn(2, 6, *size, generator=torch.Generator().manual_seed(5))
    pictures, found = [x.clone().requires_grad_() for _ in range(2)], []
    for layer, picture in zip((convolution, plain), pictures, strict=True):
        found.append(layer(picture))
        found[-1].square().sum().backward()
    torch.testing.assert_close(found[0], found[1], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(pictures[0].grad, pictures[1].grad, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(convolution.weight.grad.movedim(-1, 1), plain.weight.grad, rtol=1e-5, atol=1e-4)


def test_the_gates_slope_passes_through_its_mean():
    gate = SqueezeExcite(8, 2)
    plain = copy.deepcopy(gate)
    plain.gate[0] = nn.AdaptiveAvgPool2d(1)
    pictures = [torch.rand(2, 8, 6, 4, generator=torch.Generator().manual_seed(6)).requires_grad_() for _ in range(2)]
    for module, picture in zip((gate, plain), pictures, strict=True):
        module(picture).square().sum().backward()
    torch.testing.assert_close(pictures[0].grad, pictures[1].grad, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("normalization", ["instance", "none"])
def test_every_map_has_its_channels_last(normalization):
    network = ResUNet(replace(WIDE, normalization=normalization))
    seen = []

    def look(_module: nn.Module, _inputs: tuple[Tensor, ...], output: Tensor) -> None:
        seen.append(output.is_contiguous(memory_format=torch.channels_last))
        output.register_hook(lambda g: seen.append(g.is_contiguous(memory_format=torch.channels_last)))

    for module in network.modules():
        if isinstance(module, Convolution):
            module.register_forward_hook(look)
    network(torch.rand(1, 3, 96, 96)).square().sum().backward()
    assert len(seen) > 60
    assert all(seen)
