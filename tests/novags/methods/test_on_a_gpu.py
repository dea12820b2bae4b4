"""Methods follow the device of their problem."""

import pytest
import torch

from novags.methods import METHODS, chosen
from novags.testbed.console.devices import has_gsplat

WORKS = torch.cuda.is_available() and has_gsplat()
SHORT = {
    "init_scale": 0.7, "fit.iterations": 60, "fit.sh_degree": 1, "denoiser.warmup_steps": 20, "consistency.start": 0.2,
}  # fmt: skip


# Training on a GPU takes one; that the same methods learn the right thing is tested on the CPU, everywhere.
@pytest.mark.gpu
@pytest.mark.skipif(not WORKS, reason="needs a CUDA device and gsplat")
@pytest.mark.parametrize("name", ["naive", "nova-fast", "oracle"])
def test_a_gpu_reconstructs_like_the_cpu(problem, name: str) -> None:
    """Other sums and other random numbers, so not the same bits: renders within half a decibel of each other."""
    variant, errors = chosen(name), []
    config = variant.config(METHODS[variant.method].config(), SHORT)
    for device in ("cpu", "cuda"):
        moved = problem().to(device)
        result = METHODS[variant.method].train(moved, config)
        image, alpha, depth = result.render(moved.views)
        assert {t.device.type for t in (image, alpha, depth)} == {device}
        assert result.targets.device.type == device
        errors.append(float((image - result.targets).square().mean()))
    assert 0.89 < errors[1] / errors[0] < 1.12
