"""Claims about networks on disk with missing or odd parts: refused by name, never taken for trained ones."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from novags.methods.nova.config import ConsistencyConfig, NovaConfig
from novags.methods.nova.denoiser_config import DenoiserConfig, ResUNetConfig
from novags.methods.nova.trainer import train
from novags.splats import FitConfig
from novags.splats.files.tensors import read, write_tensors
from novags.splats.training.companion import pack, unpack

NETWORK = ResUNetConfig(widths=(4,), bottleneck=4, normalization="none")
CONFIG = NovaConfig(
    denoiser=DenoiserConfig(network=NETWORK, warmup_steps=2, denoise_every=None),
    consistency=ConsistencyConfig(start=0.0, max_angle=60),
    refresh_after=2,
    fit=FitConfig(iterations=2, sh_degree=1, checkpoint_every=1),
)
CHECKPOINT = "run.denoiser.safetensors"


@pytest.fixture
def tensors(problem, tmp_path: Path) -> dict[str, Tensor]:
    """Those of a finished run in `tmp_path`."""
    train(problem(), CONFIG, checkpoint=tmp_path / "run.safetensors")
    return read(tmp_path / CHECKPOINT)


def test_every_missing_or_odd_tensor_is_refused_by_name(problem, tensors: dict[str, Tensor], tmp_path: Path) -> None:
    weight = next(name for name in tensors if name.startswith("denoiser.weights.") and tensors[name].ndim == 4)
    name = weight.removeprefix("denoiser.weights.")
    damages: dict[str, Tensor | None] = {
        weight: None,
        f"denoiser.exp_avg.{name}": None,
        f"denoiser.exp_avg_sq.{name}": torch.zeros(3),
        f"denoiser.step.{name}": torch.full((), torch.nan),
        "denoiser.generator": torch.zeros(7, dtype=torch.uint8),
        "denoiser.steps": torch.tensor(10**9),
        "seconds": torch.tensor(torch.nan),
        "run": torch.zeros(16),
        "start.means": None,
        "clean.99.0": torch.zeros(24, 24, 3),
        "clean.x": torch.zeros(24, 24, 3),
        "fit": torch.zeros(5, dtype=torch.uint8),
    }
    for damaged, value in damages.items():
        changed = {key: tensor for key, tensor in tensors.items() if key != damaged}
        write_tensors(tmp_path / CHECKPOINT, changed if value is None else {**changed, damaged: value})
        with pytest.raises(ValueError, match=r"run\.(denoiser\.)?safetensors.*delete it") as caught:
            train(problem(), CONFIG, checkpoint=tmp_path / "run.safetensors")
        assert "\n" not in str(caught.value), damaged
    write_tensors(tmp_path / CHECKPOINT, tensors)
    train(problem(), CONFIG, checkpoint=tmp_path / "run.safetensors")


def test_weights_of_another_type_or_not_finite_are_refused() -> None:
    network = torch.nn.Linear(2, 2)
    adam = torch.optim.Adam(network.parameters())
    whole = pack("n", network, adam)
    for value in (torch.zeros(2, 2, dtype=torch.float64), torch.full((2, 2), torch.inf)):
        with pytest.raises(ValueError, match="checkpoint's n has another shape"):
            unpack("n", {**whole, "n.weights.weight": value}, network, adam)
