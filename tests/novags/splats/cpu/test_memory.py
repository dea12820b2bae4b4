"""The memory of the rasteriser: what a pass takes, that nothing else grows with the Gaussians, and waves of lists."""

import tracemalloc

import numpy as np
import pytest
import torch

from novags.splats import rasterize
from novags.splats.cpu import pipeline
from novags.splats.cpu.memory import empty


def as_float32(scene):
    return {k: v.float() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}


def test_a_pass_takes_the_memory_that_is_stated(make_scene, monkeypatch):
    """Bytes: 360 per Gaussian at SH degree 3, 74 per (Gaussian, tile) pair, 64 per pixel, 65,536 per thread."""
    taken, frames, forward = [], [], pipeline.forward

    def counting(shape, dtype=np.float32):
        taken.append(np.prod(shape) * np.dtype(dtype).itemsize)
        return empty(shape, dtype)

    monkeypatch.setattr(pipeline, "empty", counting)
    monkeypatch.setattr(pipeline, "forward", lambda *arguments: frames.append(forward(*arguments)) or frames[-1])
    scene = as_float32(make_scene(6, 8000, 160, 96, sh_degree=3))
    scene["scales"] *= 0.3
    totals = []
    for n_features in (None, 4, 8, 12):
        if n_features is not None:
            scene = {**scene, "colors": torch.rand(8000, n_features), "sh_degree": None}
        taken.clear()
        scene["means"].requires_grad_()
        image, _, _ = rasterize(**scene, backend="numba")
        image.sum().backward()
        totals.append(sum(taken))
    pairs = int(frames[0][0].splats.counts.sum())
    assert pairs > 8000
    threads = 65_536 * torch.get_num_threads()
    assert totals[0] == pytest.approx(360 * 8000 + 74 * pairs + 64 * 160 * 96 + threads, rel=0.01)
    for more in (totals[2] - totals[1], totals[3] - totals[2]):
        assert more == pytest.approx(80 * 8000 + 66 * pairs + 40 * 160 * 96, rel=0.01)


def test_nothing_per_gaussian_is_allocated_outside_the_recycler(make_scene):
    """Measured: what numpy still allocates in a pass after the first does not grow with the Gaussians."""
    peaks = []
    for n in (10_000, 40_000):
        scene = as_float32(make_scene(6, n, 64, 64, sh_degree=1))
        scene["means"][:, 2] += 50  # few pairs
        scene["means"].requires_grad_()
        for _ in range(3):
            tracemalloc.start()
            rasterize(**scene, backend="numba")[0].sum().backward()
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[5] - peaks[2] < 30_000  # a byte per Gaussian


def test_many_channels_over_several_waves_match_the_reference(make_scene, monkeypatch):
    """Lists are made in waves of 1,024 Gaussians and twice as many each time; each four channels walk through all."""
    frames, forward = [], pipeline.forward
    monkeypatch.setattr(pipeline, "forward", lambda *arguments: frames.append(forward(*arguments)) or frames[-1])
    monkeypatch.setattr(pipeline, "WAVE", 1)
    scene = make_scene(10, 8000, 20, 18)
    scene["opacities"] = (0.02 * scene["opacities"] + 0.004).float().double()
    g = torch.Generator().manual_seed(3)
    scene["colors"] = torch.rand(8000, 9, generator=g).double()
    weights = torch.randn(1, 18, 20, 10, generator=g).double()
    names = ["means", "quats", "scales", "opacities", "colors", "viewmats"]
    results = []
    for backend, dtype in (("torch", torch.float64), ("numba", torch.float32)):
        arguments = {k: v.clone().to(dtype) if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
        for name in names:
            arguments[name].requires_grad_()
        image, _, _ = rasterize(**arguments, render_mode="RGB+D", backend=backend)
        (image * weights.to(dtype)).sum().backward()
        results.append([image.detach().double(), *(arguments[name].grad.double() for name in names)])
    assert len(frames[0][0].waves) >= 3
    assert len(frames[0][0].passes) == 3
    for got, expected in zip(*results[::-1], strict=True):
        # a few of these faint Gaussians tip over the alpha threshold
        torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-2 * float(expected.abs().max()))
