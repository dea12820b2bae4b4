import math

import pytest
import torch

from novags.methods.nova.blindspot import laplacian_prior, n2v_loss, replace_masked, sample_mask
from novags.methods.nova.denoiser_config import BlindSpotConfig


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def edge_image(size: int = 32) -> torch.Tensor:
    image = torch.zeros(1, 3, size, size)
    image[..., size // 2 :] = 1
    return image


def test_prior_sums_to_one_and_lives_on_the_edge():
    prior = laplacian_prior(edge_image())
    assert float(prior.sum()) == pytest.approx(1)
    assert float(prior[..., 15:17].sum()) == pytest.approx(1, abs=1e-5)


def test_prior_of_a_constant_image_is_uniform():
    prior = laplacian_prior(torch.full((1, 3, 8, 8), 0.4))
    torch.testing.assert_close(prior, torch.full((1, 8, 8), 1 / 64))


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_masks_hold_exactly_the_configured_number_of_pixels(share):
    images = torch.rand(3, 3, 20, 24, generator=generator())
    mask = sample_mask(images, 0.06, share, generator())
    assert mask.sum((1, 2)).tolist() == [round(0.06 * 480)] * 3


def test_masks_follow_the_mixture_of_prior_and_uniform():
    image, share, fraction, draws = edge_image(), 0.5, 0.02, 400
    masks = sample_mask(image.expand(draws, -1, -1, -1), fraction, share, generator(1))
    count = round(fraction * 32 * 32)
    targeted = round(share * count)
    on_edge = masks[..., 15:17].sum((1, 2)).float()
    # Uniform spots avoid the targeted ones; the edge has 64 of 1024 pixels, `targeted` of them taken.
    uniform = count - targeted
    p = (64 - targeted) / (1024 - targeted)
    tolerance = 5 * math.sqrt(uniform * p * (1 - p) / draws)
    assert abs(float(on_edge.mean()) - targeted - uniform * p) < tolerance


def test_sixty_thousand_pixels_unless_the_view_is_small():
    config = BlindSpotConfig()
    assert config.fraction(1156 * 868) == pytest.approx(60_000 / (1156 * 868))
    assert config.fraction(375 * 500) == pytest.approx(60_000 / (375 * 500))  # the smallest views of the paper, LOM
    assert BlindSpotConfig(mask_fraction=0.9).fraction(375 * 500) == pytest.approx(0.32)
    assert BlindSpotConfig(mask_count=None).fraction(2000 * 2000) == 0.32


def test_pixels_outside_the_mask_stay_and_inside_come_from_the_neighbourhood_but_never_from_themselves():
    height, width = 13, 9
    index = torch.arange(height * width, dtype=torch.float32).reshape(1, 1, height, width).expand(1, 3, -1, -1)
    mask = torch.ones(1, height, width, dtype=torch.bool)
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    for seed in range(20):
        replaced = replace_masked(index, mask, 5, generator(seed))[0, 0].long()
        from_y, from_x = replaced // width, replaced % width
        assert ((from_y != y) | (from_x != x)).all()
        # The window is shifted inwards at the border, where it reaches up to four pixels far.
        assert (from_y - y).abs().max() <= 4
        assert (from_x - x).abs().max() <= 4
        inner = (slice(2, -2), slice(2, -2))
        assert (from_y - y)[inner].abs().max() <= 2
        assert (from_x - x)[inner].abs().max() <= 2
    mask[:, :5] = False
    assert torch.equal(replace_masked(index, mask, 5, generator())[..., :5, :], index[..., :5, :])


def test_all_24_neighbours_are_equally_likely():
    count = 24_000
    image = torch.arange(25.0).reshape(1, 1, 5, 5).expand(count, 3, -1, -1)
    mask = torch.zeros(count, 5, 5, dtype=torch.bool)
    mask[:, 2, 2] = True
    drawn = torch.bincount(replace_masked(image, mask, 5, generator())[:, 0, 2, 2].long(), minlength=25)
    assert drawn[12] == 0
    others = drawn[torch.arange(25) != 12].double()
    assert (others - count / 24).abs().max() < 5 * math.sqrt(count / 24)


def test_a_single_pixel_has_no_neighbour():
    with pytest.raises(ValueError, match="neighbour"):
        replace_masked(torch.zeros(1, 3, 1, 1), torch.ones(1, 1, 1, dtype=torch.bool), 5, generator())


def test_the_loss_is_the_mean_squared_colour_distance_of_masked_pixels_alone():
    prediction, noisy = torch.zeros(1, 3, 4, 4), torch.full((1, 3, 4, 4), 7.0)
    mask = torch.zeros(1, 4, 4, dtype=torch.bool)
    mask[0, 0, 0] = mask[0, 2, 3] = True
    noisy[0, :, 0, 0] = torch.tensor([1.0, 0.0, 0.0])
    noisy[0, :, 2, 3] = torch.tensor([0.0, 2.0, 1.0])
    prediction.requires_grad_()
    loss = n2v_loss(prediction, noisy, mask)
    assert loss.item() == pytest.approx((1 + 5) / 2)
    loss.backward()
    assert torch.equal((prediction.grad != 0).any(1), mask)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"mask_fraction": 0.0}, r"mask_fraction must lie in \(0, 1\), got 0.0"),
        ({"mask_count": 0}, "mask_count must be >= 1 or None, got 0"),
        ({"laplacian_share": 1.5}, r"laplacian_share must lie in \[0, 1\], got 1.5"),
        ({"window": 4}, "window must be odd and >= 3 px, got 4"),
    ],
)
def test_impossible_configurations_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        BlindSpotConfig(**wrong)
