"""Blind spots against loops over pixels, and their distributions against the probabilities that the paper states."""

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from novags.methods.nova.blindspot import laplacian_prior, n2v_loss, replace_masked, sample_mask
from novags.methods.nova.denoiser_config import BlindSpotConfig

UNLIKELY = 5.7e-7  # two-sided probability beyond 5 standard errors


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def assert_drawn_from(counts: np.ndarray, probabilities: np.ndarray) -> None:
    """Pearson's chi-square test."""
    assert counts[probabilities == 0].sum() == 0
    counts, probabilities = counts[probabilities > 0], probabilities[probabilities > 0]
    expected = counts.sum() * probabilities
    assert expected.min() > 20
    assert ((counts - expected) ** 2 / expected).sum() < chi2.isf(UNLIKELY, len(counts) - 1)


def test_the_published_choices_are_the_defaults():
    config = BlindSpotConfig()
    assert (config.mask_count, config.laplacian_share, config.window, config.per_channel) == (60_000, 0.5, 5, False)


def test_the_prior_is_the_normalised_laplacian_of_the_mean_colour():
    images = torch.rand(2, 3, 5, 7, generator=generator(), dtype=torch.float64)
    for found, picture in zip(laplacian_prior(images), images, strict=True):
        grey = np.pad(picture.numpy().mean(0), 1, mode="edge")
        magnitude = np.empty((5, 7))
        for y, x in np.ndindex(5, 7):
            centre = grey[y + 1, x + 1]
            around = grey[y, x + 1] + grey[y + 2, x + 1] + grey[y + 1, x] + grey[y + 1, x + 2]
            magnitude[y, x] = abs(around - 4 * centre)
        np.testing.assert_allclose(found, magnitude / magnitude.sum(), rtol=1e-9)


def test_a_targeted_pixel_is_drawn_with_the_probability_of_the_prior():
    image = torch.rand(1, 3, 4, 5, generator=generator(2))
    prior = laplacian_prior(image)[0].double().numpy().ravel()
    masks = sample_mask(image.expand(20_000, -1, -1, -1), 1 / 20, 1.0, generator(3))
    assert (masks.sum((1, 2)) == 1).all()
    counts = masks.sum(0).numpy().ravel()
    expected = 20_000 * prior
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected * (1 - prior)) + 1e-9).all()


def test_pixels_that_are_not_targeted_are_drawn_uniformly():
    image = torch.rand(1, 3, 4, 5, generator=generator(2))
    masks = sample_mask(image.expand(20_000, -1, -1, -1), 0.05, 0.0, generator(4))
    assert_drawn_from(masks.sum(0).numpy().ravel(), np.full(20, 1 / 20))


def test_every_image_is_targeted_by_its_own_prior():
    images = torch.zeros(2, 3, 8, 8)
    images[0, :, :, 4:] = 1
    images[1, :, 4:] = 1
    masks = sample_mask(images, 0.25, 1.0, generator())
    assert masks[0, :, 3:5].all()
    assert masks[1, 3:5].all()


@pytest.mark.parametrize(("fraction", "count"), [(1e-6, 1), (0.031, 2), (0.05, 3), (0.99, 63)])
def test_the_number_of_blind_spots_is_the_rounded_fraction_but_at_least_one(fraction, count):
    masks = sample_mask(torch.rand(3, 3, 8, 8, generator=generator()), fraction, 0.5, generator())
    assert masks.dtype == torch.bool
    assert masks.sum((1, 2)).tolist() == [count] * 3


def test_the_share_says_how_many_follow_the_prior():
    image = torch.zeros(1, 3, 40, 40)
    image[..., 20:] = 1
    on_edge = {}
    for share in (0.25, 0.75):
        mask = sample_mask(image.expand(50, -1, -1, -1), 0.02, share, generator())
        on_edge[share] = mask[..., 19:21].sum((1, 2)).float()
        # 32 spots, the targeted ones all on the edge, which is 5 % of the image
        assert on_edge[share].min() >= round(share * 32)
        assert on_edge[share].mean() < round(share * 32) + 4


@pytest.mark.parametrize(
    ("size", "pixel", "rows", "columns"),
    [
        ((9, 8), (4, 4), (2, 7), (2, 7)),
        ((9, 8), (0, 0), (0, 5), (0, 5)),
        ((9, 8), (8, 7), (4, 9), (3, 8)),
        ((9, 8), (1, 6), (0, 5), (3, 8)),
        ((3, 8), (1, 4), (0, 3), (2, 7)),
        ((8, 2), (5, 1), (3, 8), (0, 2)),
    ],
)
def test_replacements_are_uniform_over_the_window_shifted_inwards_without_its_own_pixel(size, pixel, rows, columns):
    draws = 12_000
    index = torch.arange(size[0] * size[1], dtype=torch.float32).reshape(1, 1, *size)
    mask = torch.zeros(draws, *size, dtype=torch.bool)
    mask[:, pixel[0], pixel[1]] = True
    replaced = replace_masked(index.expand(draws, -1, -1, -1), mask, 5, generator())[:, 0, pixel[0], pixel[1]]
    candidates = np.zeros(size)
    candidates[slice(*rows), slice(*columns)] = 1
    candidates[pixel] = 0
    counts = np.bincount(replaced.long().numpy(), minlength=index.numel())
    assert_drawn_from(counts, candidates.ravel() / candidates.sum())


def test_a_replacement_is_one_whole_pixel_of_the_same_image():
    images = torch.arange(2 * 3 * 6 * 7, dtype=torch.float32).reshape(2, 3, 6, 7)
    mask = torch.rand(2, 6, 7, generator=generator()) < 0.5
    replaced = replace_masked(images, mask, 3, generator())
    for view, y, x in np.ndindex(2, 6, 7):
        known = {tuple(c.tolist()) for c in images[view].flatten(1).T}
        colour = tuple(replaced[view, :, y, x].tolist())
        assert colour in known
        assert (colour == tuple(images[view, :, y, x].tolist())) == (not mask[view, y, x])


def test_two_pixels_suffice_to_replace_each_other():
    image = torch.tensor([1.0, 2.0]).reshape(1, 1, 1, 2)
    swapped = replace_masked(image, torch.ones(1, 1, 2, dtype=torch.bool), 5, generator())
    assert swapped.flatten().tolist() == [2.0, 1.0]


def test_the_loss_sums_colours_and_averages_over_the_spots_of_all_images():
    prediction = torch.rand(2, 3, 4, 5, generator=generator(1), dtype=torch.float64)
    noisy = torch.rand(2, 3, 4, 5, generator=generator(2), dtype=torch.float64)
    mask = torch.rand(2, 4, 5, generator=generator(3)) < 0.3
    total = 0.0
    for b, y, x in mask.nonzero().tolist():
        total += sum(float(prediction[b, c, y, x] - noisy[b, c, y, x]) ** 2 for c in range(3))
    assert float(n2v_loss(prediction, noisy, mask)) == pytest.approx(total / int(mask.sum()))
