import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from novags.baselines.blur import gaussian_blur


@pytest.mark.parametrize("sigma", [0.4, 1.2, 3.0])
def test_blur_equals_scipys(sigma):
    images = np.random.default_rng(0).uniform(0, 1, (2, 15, 11, 3))
    # scipy rounds its radius to int(4 sigma + 0.5); a radius of ceil(4 sigma) adds weights below exp(-8).
    expected = gaussian_filter(images, (0, sigma, sigma, 0), mode="nearest", radius=int(np.ceil(4 * sigma)))
    np.testing.assert_allclose(gaussian_blur(torch.tensor(images), sigma).numpy(), expected, atol=1e-12)


def test_a_single_image_is_blurred_like_one_of_a_batch():
    image = torch.rand(9, 7, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(gaussian_blur(image, 1.0), gaussian_blur(image[None], 1.0)[0])


@pytest.mark.parametrize(("shape", "sigma"), [((9, 7), 1.0), ((9, 7, 3), 0.0), ((9, 7, 3), float("nan"))])
def test_other_shapes_and_widths_are_refused(shape, sigma):
    with pytest.raises(ValueError, match="sigma > 0"):
        gaussian_blur(torch.zeros(shape), sigma)
