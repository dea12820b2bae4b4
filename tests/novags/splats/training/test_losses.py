"""SSIM, the photometric loss and its fused gradient."""

import pytest
import torch

from novags.splats import photometric_loss, ssim


def images(height, width, channels=3, seed=0, dtype=torch.float32):
    g = torch.Generator().manual_seed(seed)
    return torch.rand(2, height, width, channels, generator=g, dtype=dtype)


def test_ssim_equals_torchmetrics_away_from_the_border():
    from torchmetrics.image import StructuralSimilarityIndexMeasure

    a, b = images(40, 33)
    b = (0.7 * a + 0.3 * b).clone()
    metric = StructuralSimilarityIndexMeasure(
        data_range=1.0, sigma=1.5, kernel_size=11, return_full_image=True, reduction="none"
    )
    _, full = metric(a.movedim(-1, 0)[None], b.movedim(-1, 0)[None])
    # torchmetrics pads by reflection, 3DGS by zeros: equal where the window is inside
    from novags.splats.training.losses import ssim_map

    torch.testing.assert_close(ssim_map(a, b)[5:-5, 5:-5], full[0].movedim(0, -1)[5:-5, 5:-5], atol=1e-5, rtol=1e-4)


def test_ssim_is_one_for_equal_images_symmetric_and_at_most_one():
    a, b = images(20, 25)
    assert ssim(a, a).item() == pytest.approx(1.0, abs=1e-6)
    assert ssim(a, b).item() == pytest.approx(ssim(b, a).item(), abs=1e-6)
    assert ssim(a, b).item() < 0.5


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
@pytest.mark.parametrize(
    "shape", [(40, 33, 3), (16, 16, 1), (1, 1, 3), (3, 50, 4), (50, 3, 3), (5, 301, 3), (103, 64, 2)]
)
def test_fused_loss_and_gradient_equal_autograd_in_float64(weight, shape):
    a, b = images(*shape)
    b[0, 0] = a[0, 0]  # |x| has no slope at zero
    x = a.clone().requires_grad_()
    loss = photometric_loss(x, b, weight)
    (3 * loss).backward()
    reference = a.double().requires_grad_()
    expected = photometric_loss(reference, b.double(), weight)
    (3 * expected).backward()
    assert loss.item() == pytest.approx(expected.item(), abs=1e-6)
    assert (x.grad - reference.grad).abs().max() < 1e-6 * (reference.grad.abs().max() + 3 / a.numel())


@pytest.mark.parametrize("of_image", [True, False])
def test_gradient_of_a_target_that_asks_for_it_equals_autograd_in_float64(of_image):
    a, b = images(23, 31)
    x, y = a.clone().requires_grad_(of_image), b.clone().requires_grad_()
    loss = photometric_loss(x, y, 0.2)
    (3 * loss).backward()
    x64, y64 = a.double().requires_grad_(of_image), b.double().requires_grad_()
    expected = photometric_loss(x64, y64, 0.2)
    (3 * expected).backward()
    assert loss.item() == pytest.approx(expected.item(), abs=1e-6)
    assert (y.grad - y64.grad).abs().max() < 1e-6 * (y64.grad.abs().max() + 3 / a.numel())
    assert not of_image or (x.grad - x64.grad).abs().max() < 1e-6 * (x64.grad.abs().max() + 3 / a.numel())


def test_different_shapes_are_refused():
    with pytest.raises(ValueError, match=r"must both be \[H, W, C\]"):
        photometric_loss(torch.zeros(4, 4, 3), torch.zeros(4, 5, 3), 0.2)
    with pytest.raises(ValueError, match=r"must both be \[H, W, C\]"):
        ssim(torch.zeros(4, 4), torch.zeros(4, 4))


def test_a_second_derivative_is_refused_by_the_fused_loss_and_given_in_float64():
    a, b = images(8, 8)
    x = a.clone().requires_grad_()
    with pytest.raises(RuntimeError, match="no second derivative"):
        torch.autograd.grad(photometric_loss(x, b, 0.2), x, create_graph=True)
    x = a.double().requires_grad_()
    (gradient,) = torch.autograd.grad(photometric_loss(x, b.double(), 0.2), x, create_graph=True)
    gradient.square().sum().backward()
    assert x.grad.abs().sum() > 0


def test_images_of_two_precisions_are_compared_by_the_readable_loss():
    image, target = torch.rand(2, 12, 14, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    expected = photometric_loss(image, target, 0.2)
    for pair in ((image.float(), target), (image, target.float())):
        torch.testing.assert_close(photometric_loss(*pair, 0.2), expected, rtol=1e-5, atol=1e-6, check_dtype=False)
