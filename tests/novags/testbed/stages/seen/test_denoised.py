"""Claims about the denoised pictures that cameras are looked for in."""

from typing import Any

import numpy as np
import pytest
import torch

from novags.testbed.stages.seen import SEEN, denoised, enhanced
from novags.testbed.stages.seen.raw import codes


class Network:
    """Draws instead of learning."""

    def __init__(self, pictures: torch.Tensor, config: Any, total_steps: int, seed: int) -> None:
        self.pictures, self.generator = pictures, torch.Generator().manual_seed(seed)

    def train_step(self) -> None:
        self.noise = torch.rand(self.pictures.shape, generator=self.generator)

    def denoised(self, picture: torch.Tensor) -> torch.Tensor:
        return (picture + self.noise[0, : len(picture), : len(picture[0])]) / 2


def test_another_seed_learns_otherwise_and_the_same_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(denoised, "Denoiser", Network)
    dark = torch.rand(2, 24, 32, 3, generator=torch.Generator().manual_seed(0)) / 8
    first, again, other = (np.stack(list(denoised.pictures(tuple(dark), seed))) for seed in (3, 3, 4))
    assert (first == again).all()
    assert (first != other).any()


class Read(list[torch.Tensor]):
    """Pictures that note which of them is read."""

    asked: list[Any]

    def __getitem__(self, i: Any) -> Any:
        self.asked.append(range(len(self))[i])
        return super().__getitem__(i)

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))


@pytest.mark.parametrize(
    ("most", "learnt", "once"), [(10**6, [0, 1, 2, 4], []), (3 * 24 * 32, [0, 2, 4], [1, 3]), (1, [0], [1, 2, 3, 4])]
)
def test_the_network_learns_from_so_many_pixels_of_the_most_common_size_and_denoises_all(
    most: int, learnt: list[int], once: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five pictures, the fourth of another size: where few may be read, those are spread over all, and every other
    photograph is read once, to be denoised.
    """
    given = list[torch.Tensor]()

    class Asked(Network):
        def __init__(self, pictures: torch.Tensor, *more: Any, **settings: Any) -> None:
            given.append(pictures)
            super().__init__(pictures, *more, **settings)

    monkeypatch.setattr(denoised, "Denoiser", Asked)
    monkeypatch.setattr(denoised, "LEARNT", most)
    draw = torch.Generator().manual_seed(0)
    dark = Read(torch.rand(*((20, 24) if k == 3 else (24, 32)), 3, generator=draw) / 8 for k in range(5))
    dark.asked = []
    found = list(denoised.pictures(dark, 0))
    assert torch.equal(given[0], torch.stack([enhanced.enhanced(dark[i]) for i in learnt]))
    assert [dark.asked.count(i) for i in once] == [1] * len(once)
    assert [picture.shape for picture in found] == [tuple(view.shape) for view in dark]
    noise = Network(given[0], None, 1, 0)
    for _ in range(denoised.STEPS):
        noise.train_step()
    for picture, view in zip(found, dark, strict=True):
        assert (picture == codes(noise.denoised(enhanced.enhanced(view)))).all()


def test_pictures_are_read_one_after_the_other() -> None:
    """Photographs of a hundred megapixels in all need not be in memory at once."""
    dark = Read(torch.full((24, 32, 3), 0.02 * (k + 1)) for k in range(3))
    for kind in ("raw", "enhanced"):
        dark.asked = []
        found = SEEN[kind](dark, 0)
        next(found)
        assert dark.asked == [0]
    assert (next(found) == codes(enhanced.enhanced(dark[1]))).all()
