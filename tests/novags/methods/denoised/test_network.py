"""The network before training, at every size, and what it may not look at."""

import math

import numpy as np
import pytest
import torch

from novags.methods.denoised.network import LARGEST_READ_VARIANCE, Network, NetworkConfig
from novags.methods.denoised.packing import filled, mask_of
from sensor_model.params import Cfa

SMALL = NetworkConfig(widths=(8, 12, 16), blocks=(1, 1, 1))


def random_network(seed: int = 0) -> Network:
    torch.manual_seed(seed)
    network = Network(SMALL)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    return network


@pytest.mark.parametrize("cfa", [None, "RGGB"])
@pytest.mark.parametrize("size", [(2, 2), (3, 5), (17, 8), (64, 50)])
def test_before_training_it_returns_the_measured_values_and_interpolates_the_others(
    cfa: Cfa | None, size: tuple[int, int]
) -> None:
    values, mask = torch.randn(2, 3, *size), mask_of(size, cfa).expand(2, -1, -1, -1)
    found = Network(SMALL)(values * mask, mask, torch.ones(2, 3))
    torch.testing.assert_close(found, filled(values * mask, mask))


@pytest.mark.parametrize("cfa", [None, "BGGR"])
def test_values_where_nothing_was_measured_do_not_matter(cfa: Cfa | None) -> None:
    mask = mask_of((12, 14), cfa)
    values = torch.randn(1, 3, 12, 14, generator=torch.Generator().manual_seed(0))
    other = torch.where(mask > 0, values, 99.0)
    network, variance = random_network(), torch.ones(1, 3)
    with torch.no_grad():
        torch.testing.assert_close(network(other, mask, variance), network(values, mask, variance))


def test_it_is_shown_differences_from_local_means_these_means_the_mask_and_the_level_of_read_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network, shown = random_network(), list[np.ndarray]()
    monkeypatch.setattr(network, "_run", lambda x: shown.append(x[0].numpy()) or torch.zeros(1, 12, 4, 4))
    values, mask = torch.randn(1, 3, 8, 8, generator=torch.Generator().manual_seed(0)), mask_of((8, 8), None)
    network(values, mask, torch.tensor([[0.2, 0.5, 2.3]]))
    (found,) = shown
    picture, local = values[0].numpy(), np.empty((3, 8, 8))
    for c, y, x in np.ndindex(local.shape):
        local[c, y, x] = picture[c, max(0, y - 2) : y + 3, max(0, x - 2) : x + 3].mean()
    for c, y, x in np.ndindex(local.shape):
        place = 4 * c + 2 * (y % 2) + x % 2
        assert found[place, y // 2, x // 2] == pytest.approx(picture[c, y, x] - local[c, y, x], abs=1e-5)
    for c, y, x in np.ndindex(3, 4, 4):
        cell = local[c, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2]
        assert found[12 + c, y, x] == pytest.approx(cell.mean() / 8, abs=1e-6)
    assert (found[15:27] == 1).all()
    np.testing.assert_allclose(found[27], math.log2((0.2 + 0.5 + 2.3) / 3 + 0.125) / 4, rtol=1e-6)


def test_a_picture_of_any_size_is_the_corner_of_a_mirrored_one() -> None:
    """Padding mirrors about the last pixels, so that each stays under its own filter."""
    network, variance = random_network(), torch.ones(1, 3)
    mask = mask_of((13, 10), "GBRG")
    values = torch.randn(1, 3, 13, 10, generator=torch.Generator().manual_seed(0)) * mask
    large = mask_of((16, 16), "GBRG")
    rows, columns = [*range(13), 11, 10, 9], [*range(10), 8, 7, 6, 5, 4, 3]
    assert torch.equal(mask[:, :, rows][..., columns], large)
    base = filled(values, mask)[:, :, rows][..., columns]
    with torch.no_grad():
        whole = base - network.noise(base, large, variance)
        torch.testing.assert_close(network(values, mask, variance), whole[:, :, :13, :10])


def test_pictures_of_a_batch_and_their_read_noise_are_their_own() -> None:
    network = random_network()
    values, mask = torch.randn(2, 3, 16, 16), mask_of((16, 16), None).expand(2, -1, -1, -1)
    variance = torch.tensor([[0.2] * 3, [9.0] * 3])
    with torch.no_grad():
        both = network(values, mask, variance)
        for i in range(2):
            torch.testing.assert_close(both[i : i + 1], network(values[i : i + 1], mask[:1], variance[i : i + 1]))
        assert not torch.allclose(both[:1], network(values[:1], mask[:1], variance[1:]), atol=1e-4)
        loud = [network(values[:1], mask[:1], torch.full((1, 3), v)) for v in (LARGEST_READ_VARIANCE, 1e6)]
    assert torch.equal(*loud)  # what is louder than all cameras of the training is taken for the loudest


@pytest.mark.parametrize(("widths", "blocks"), [((8,), (1,)), ((8, 16), (1,)), ((8, 0), (1, 1)), ((8, 16), (1, 0))])
def test_sizes_that_are_no_network_are_refused(widths: tuple[int, ...], blocks: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="widths and blocks"):
        NetworkConfig(widths=widths, blocks=blocks)
