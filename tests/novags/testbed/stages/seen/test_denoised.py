"""Claims about the denoised pictures that cameras are looked for in."""

from typing import Any

import pytest
import torch

from novags.testbed.stages.seen import denoised


class Network:
    """Draws instead of learning."""

    def __init__(self, pictures: torch.Tensor, config: Any, total_steps: int, seed: int) -> None:
        self.pictures, self.generator = pictures, torch.Generator().manual_seed(seed)

    def train_step(self) -> None:
        self.noise = torch.rand(self.pictures.shape, generator=self.generator)

    def denoise_all(self) -> torch.Tensor:
        return (self.pictures + self.noise) / 2


def test_another_seed_learns_otherwise_and_the_same_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(denoised, "Denoiser", Network)
    dark = torch.rand(2, 24, 32, 3, generator=torch.Generator().manual_seed(0)) / 8
    first, again, other = (denoised.pictures(dark, seed) for seed in (3, 3, 4))
    assert (first == again).all()
    assert (first != other).any()
