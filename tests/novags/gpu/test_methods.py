"""Every method trains on a GPU: nothing is on the wrong device, results are a CPU's, and the GPU hardly ever waits."""

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
import torch

from novags.methods import METHODS
from novags.methods.nova import consistency
from novags.methods.problem import Problem
from novags.methods.reconstruction import Reconstruction
from novags.splats.training import fit as loop
from tests.novags.gpu.runs import on_cpu, on_gpu, short
from tests.novags.gpu.virtual import Wrong

# Renders in units of their largest number, losses of themselves: roundings of float32, through 24 steps of Adam, which
# takes small gradients for large ones. Where averages or networks come before the fit, they add theirs.
LARGEST, TYPICAL, OF_LOSSES = 1e-2, 2e-3, 5e-3
WAITS = 0.1  # for each iteration
# Most settings of each kind of loop; the others run in test_every_method_trains.
COMPARED = ("nova", "nova-fast", "nova-plus", "zero-dce-gs", "luminance-gs", "raw-gs")
OTHERS = ("denoise-gs", "hdrsplat", "sci-gs", "lita-gs", "gaussian-dk", "ll-gaussian", "raw3dgs", "3dgs4ll", "oracle",
          "gamma-gs")  # fmt: skip
FIELDS = ("nerf", "raw-nerf", "aleth-nerf", "ll-nerf", "i2-nerf", "nerf-oracle")
# Four need weights of others; one only warps pictures by the true surface, in numpy.
LEFT_OUT = {"mbllen-gs", "uretinex-gs", "retinexformer-gs", "naka-net-gs", "3dgs4ll-luma", "averaging"}


@pytest.fixture
def seen(problem: Callable[..., Problem], dark: Callable[..., tuple[Problem, torch.Tensor]]) -> Problem:
    """A problem with everything that a method may ask for."""
    return dataclasses.replace(dark()[0], clean=problem(sigma=0.0).clean)


def assert_equal_results(found: Reconstruction, wanted: Reconstruction, shown: Any, expected: Any) -> None:
    for image, other in zip(shown, expected, strict=True):
        difference = (image - other).abs()
        assert difference.max() < LARGEST * other.abs().max()
        assert difference.square().mean().sqrt() < TYPICAL * other.abs().max()
    assert [entry.keys() for entry in found.losses] == [entry.keys() for entry in wanted.losses]
    for entry, other in zip(found.losses, wanted.losses, strict=True):
        assert entry["iteration"] == other["iteration"]
        assert entry["loss"] == pytest.approx(other["loss"], rel=OF_LOSSES)


def compare(name: str, seen: Problem, monkeypatch: pytest.MonkeyPatch, *, refine: bool = False) -> None:
    method, config = short(name, refine)
    found, waits, shown = on_gpu(method, config, seen, monkeypatch)
    print(name, *(f"{each} {per_step:.2f}" for each, per_step in waits.items()))  # pytest -rP shows it
    wanted, expected = on_cpu(method, config, seen, monkeypatch)
    assert_equal_results(found, wanted, shown, expected)
    assert "fit" in waits
    assert max(waits.values()) <= WAITS, waits
    if refine:
        assert found.viewmats is not None
        assert wanted.viewmats is not None
        torch.testing.assert_close(found.viewmats, wanted.viewmats, rtol=0, atol=1e-4)
        assert not torch.equal(wanted.viewmats, seen.views.viewmats)


@pytest.mark.parametrize("name", COMPARED)
def test_a_gpu_gives_the_results_of_a_cpu_and_waits_once_in_ten_iterations(name, seen, monkeypatch) -> None:
    compare(name, seen, monkeypatch)


def test_cameras_that_are_refined_are_those_of_a_cpu(seen, monkeypatch) -> None:
    compare("naive", seen, monkeypatch, refine=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_a_gpu_gives_the_results_of_a_cpu_with_all_other_losses_too(name, seen, monkeypatch) -> None:
    compare(name, seen, monkeypatch)


def test_a_field_of_a_problem_on_a_gpu_is_that_of_one_on_a_cpu_to_the_bit(seen, monkeypatch) -> None:
    """Fields are trained on the CPU; their pictures go where the views are."""
    method, config = short("nerf")
    _, _, shown = on_gpu(method, config, seen, monkeypatch)
    _, expected = on_cpu(method, config, seen, monkeypatch)
    assert all(torch.equal(image, other) for image, other in zip(shown, expected, strict=True))


@pytest.mark.parametrize("name", sorted({*METHODS} - {*COMPARED, *LEFT_OUT, "nerf"}))
def test_every_method_trains(name, seen, monkeypatch) -> None:
    """A few iterations, without a tensor on the wrong device."""
    few = {"fit.iterations": 3, "denoise.adapt.steps": 2, "enhance.steps": 2, "pretrain.steps": 2,
           "fit.mcmc.refine_every": 2}  # fmt: skip
    method, config = short(name, **few)
    found, _, _ = on_gpu(method, config, seen, monkeypatch)
    assert found.losses[-1]["iteration"] == 3


def test_nothing_is_left_out_for_long() -> None:
    """Every name is a method; a new one is trained by the test above."""
    assert {*OTHERS, *FIELDS, *LEFT_OUT} | {*COMPARED} - {"nova-fast"} <= {*METHODS}


def test_a_number_that_is_asked_for_in_the_loop_is_noticed(seen, monkeypatch) -> None:
    method, config = short("naive")
    original = loop._move

    def asking(state: Any, *rest: Any) -> None:
        state.gaussians.means.max().item()
        original(state, *rest)

    monkeypatch.setattr(loop, "_move", asking)
    _, waits, _ = on_gpu(method, config, seen, monkeypatch)
    assert waits["fit"] > 1


def test_a_tensor_on_the_cpu_is_noticed(seen, monkeypatch) -> None:
    method, config = short("naive")
    weights = torch.ones(3)
    monkeypatch.setattr(loop, "default_photometric", lambda _, step, target: ((step.render - target) * weights).mean())
    with pytest.raises(Wrong, match=r"got a tensor \[3\] on the CPU and others on cuda:0"):
        on_gpu(method, config, seen, monkeypatch)


def test_a_picture_of_a_network_on_the_cpu_is_noticed(seen, monkeypatch) -> None:
    method, config = short("nova-fast", **{"denoiser.warmup_steps": 1})
    original = consistency.reproject

    def elsewhere(source: torch.Tensor, *rest: Any) -> Any:
        warped, mask = original(source, *rest)
        return warped.cpu(), mask

    monkeypatch.setattr(consistency, "reproject", elsewhere)
    with pytest.raises(Wrong, match="on the CPU and others on cuda:0"):
        on_gpu(method, config, seen, monkeypatch)
