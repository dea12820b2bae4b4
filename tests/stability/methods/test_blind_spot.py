"""Hard cases of the blind-spot masks: flat images, too few pixels, borders, and what the network may know of a pixel.

As in Noise2Void a blinded pixel takes the noisy value of a neighbour, which may be blinded itself: where that happens
the neighbour's value is still in the picture, but in another place. What must never happen is that a blinded pixel, or
the channel of one, keeps its own place; the gradient proves that.
"""

import sys

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.methods.nova import blindspot
from novags.methods.nova.blindspot import laplacian_prior, n2v_loss, replace_masked, sample_mask
from novags.methods.nova.denoiser import Denoiser, donut_blur
from novags.methods.nova.denoiser_config import BlindSpotConfig, DenoiserConfig, ResUNetConfig
from tests.stability.case import (
    EPS,
    LARGEST,
    Case,
    Error,
    Fails,
    Part,
    Setting,
    refusal,
    relative_error,
    worse,
    worst_error,
)

PART = Part("blind_spot")
HERE = sys.modules[__name__]  # where the cases find what a test replaces


def _stream() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def _prior(image: np.ndarray) -> np.ndarray:
    """|Laplacian| of the mean colour [H, W, D] over its sum, borders repeated, float64; 1e-12 is the code's floor."""
    grey = np.pad(image.astype(np.float64).mean(-1), 1, mode="edge")
    middle = grey[1:-1, 1:-1]
    edges = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:]
    magnitude = np.abs(edges - 4 * middle) + 1e-12
    return magnitude / magnitude.sum()


def _prior_error(image: Tensor) -> float:
    """Error of the prior of an image [H, W, 3]."""
    return relative_error(laplacian_prior(image.movedim(-1, 0)[None])[0], _prior(image.numpy()))


@PART.case("flat images: the prior is uniform", bound=20 * EPS, unit=LARGEST)
def flat(setting: Setting) -> float:
    """The Laplacian's sum is 0; so is every term, whatever a float32 sum of one level and four times it leaves.

    A sum that left one rounding would weigh pixels by it: EPS is 1e5 times the floor.
    """
    levels = [0, 1, 3, 77, 12345, 40001, 65534, 65535]
    sizes = [(1, 2), (8, 8), (17, 23), (33, 31)]
    images = [torch.tensor([a, b, a]).expand(*size, 3) / 65535 for size in sizes for a in levels for b in (a, 1000)]
    return max(_prior_error(image.contiguous()) for image in images)


@PART.case("one pixel one 16-bit step above a flat image", bound=1e-2, unit=LARGEST)
def faintest_detail(setting: Setting) -> float:
    """The step, 1.5e-5, is known to EPS / 2 at 0.9, the Laplacian to four such roundings: 1e-2 of it."""
    image = torch.full((9, 11, 3), 58982 / 65535)
    image[4, 6] += 1 / 65535
    return _prior_error(image)


@PART.case("an image of one pixel", bound=0, unit="refused")
def one_pixel(setting: Setting) -> float:
    """It has no neighbour; two pixels replace each other."""
    mask = torch.ones(1, 1, 1, dtype=torch.bool)
    refused = refusal(lambda: replace_masked(torch.rand(1, 3, 1, 1), mask, 5, _stream()), "neighbour", "1 x 1 px")
    pair = torch.tensor([[[[0.25, 0.75]]]])
    found = replace_masked(pair, torch.ones(1, 1, 2, dtype=torch.bool), 5, _stream())
    return max(refused, relative_error(found, pair.flip(-1)))


@PART.case("more blind spots asked for than there are pixels", bound=0, unit="pixels too many or too few")
def more_than_pixels(setting: Setting) -> float:
    """60,000 of 64; nearly all; all of them by the prior of a flat image; one pixel of two."""
    worst = 0.0
    for count, fraction, size in ((60_000, 0.32, (8, 8)), (None, 1 - 1e-9, (8, 8)), (1, 0.5, (1, 2))):
        share = BlindSpotConfig(mask_count=count, mask_fraction=fraction).fraction(size[0] * size[1])
        wanted = max(1, round(min(fraction, (count or 1e9) / (size[0] * size[1])) * size[0] * size[1]))
        for image in (torch.zeros(2, 3, *size), torch.rand(2, 3, *size, generator=_stream())):
            for targeted in (0.0, 0.5, 1.0):
                mask = sample_mask(image, share, targeted, _stream())
                worst = max(worst, float((mask.flatten(1).sum(1) - wanted).abs().max()))
    return worst


@PART.case("borders: replacements lie in the window and are never the pixel itself", bound=0, unit="wrong pixels")
def borders(setting: Setting) -> float:
    """Every pixel of small images blinded, with windows larger than the image."""
    wrong = 0
    for height, width, window in ((1, 2, 3), (1, 9, 5), (4, 1, 7), (5, 6, 5), (3, 3, 11), (9, 7, 3)):
        index = torch.arange(height * width, dtype=torch.float64).reshape(1, 1, height, width)
        row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        stream = _stream()
        for _ in range(20):
            source = replace_masked(index, torch.ones(1, height, width, dtype=torch.bool), window, stream)[0, 0].long()
            near = torch.maximum((source // width - row).abs(), (source % width - column).abs())
            wrong += int(((source == index[0, 0].long()) | (near >= window)).sum())
    return float(wrong)


@PART.case("the centre never leaks: the blinded picture", bound=0, unit="slope to the pixel's own place")
def no_leak_of_the_mask(setting: Setting) -> float:
    """The Jacobian of the blinded picture has no diagonal where it is blinded, and is the identity elsewhere."""
    image = torch.rand(1, 1, 5, 6, generator=_stream(), dtype=torch.float64)
    mask = torch.rand(1, 5, 6, generator=_stream()) < 0.6

    def blinded(x: Tensor) -> Tensor:
        return replace_masked(x, mask, 5, _stream())

    jacobian = torch.autograd.functional.jacobian(blinded, image).reshape(30, 30)
    own = jacobian.diagonal()
    return float((own - (~mask).flatten().double()).abs().max())


@PART.case("the centre never leaks: through the network", bound=0, unit="slope to the pixel's own value")
def no_leak_of_the_network(setting: Setting) -> float:
    """One blind spot: the prediction there has no slope in the noisy value there.

    For whole pixels, for channels, and for samples of a mosaic.
    """
    worst = 0.0
    for per_channel, packed in ((False, False), (True, False), (True, True)):
        config = DenoiserConfig(
            network=ResUNetConfig(widths=(4, 8), bottleneck=8, normalization="none"),
            blind_spots=BlindSpotConfig(per_channel=per_channel, packed=packed), residual_blur=0.8,
        )  # fmt: skip
        edge = 24 if packed else 12
        picture = torch.rand(1, edge, edge, 3, generator=_stream())
        denoiser = Denoiser(picture, config, total_steps=1, seed=0, cfa="RGGB")
        torch.nn.init.normal_(denoiser.network.head.weight, generator=_stream())
        noisy = denoiser.images[:1].clone().requires_grad_()
        planes = noisy.flatten(0, 1).unsqueeze(1) if per_channel else noisy
        mask = torch.zeros(len(planes), 12, 12, dtype=torch.bool)
        mask[0, 7, 3] = True
        prediction = denoiser.predict(replace_masked(planes, mask, 5, _stream()).view_as(noisy))
        (slope,) = torch.autograd.grad(prediction[0, 0, 7, 3], noisy)
        worst = worse(worst, float(slope[0, : 1 if per_channel else 3, 7, 3].abs().max()))
        if float(slope.abs().max()) == 0:  # nothing at all: the test would be blind itself
            return float("inf")
    return worst


@PART.case("the centre never leaks: the blur that is predicted from", bound=0, unit="slope to the pixel's own value")
def no_leak_of_the_blur(setting: Setting) -> float:
    """For kernels from a point to the size of the image, where the kernel does not reach over the border."""
    worst = 0.0
    for size, sigma in (((2, 2), 0.1), ((8, 9), 0.8), ((12, 12), 1.6), ((7, 7), 100.0)):
        images = torch.rand(1, 1, *size, generator=_stream())
        n = size[0] * size[1]
        jacobian = torch.autograd.functional.jacobian(lambda x, s=sigma: donut_blur(x, s), images).reshape(n, n)
        inside = torch.zeros(size, dtype=torch.bool)
        radius = min(max(1, int(np.ceil(3 * sigma))), min(size) - 1)
        inside[radius:-radius, radius:-radius] = True
        own = jacobian.diagonal().reshape(size)[inside]
        worst = max(worst, float(own.abs().max()) if own.numel() else 0.0)
        if not torch.isfinite(jacobian).all() or relative_error(jacobian.sum(1), np.ones(n)) > 10 * EPS:
            return float("inf")
    return worst


@PART.case("the loss over a quarter million spots", bound=20 * EPS, unit=LARGEST)
def many_spots(setting: Setting) -> float:
    """One float32 sum of large and tiny squares; a running sum would lose 2^18 EPS / 2, some 1e-2."""
    prediction = torch.rand(1, 3, 512, 512, generator=_stream()) ** 8 * 1e3
    noisy = torch.rand(1, 3, 512, 512, generator=_stream().manual_seed(1))
    mask = torch.ones(1, 512, 512, dtype=torch.bool)
    x, y = prediction.clone().requires_grad_(), prediction.double().requires_grad_()
    found = n2v_loss(x, noisy, mask)
    wanted = (y - noisy.double()).square().mean((0, 2, 3)).sum()
    found.backward()
    wanted.backward()
    return worst_error([(found, wanted), (x.grad, y.grad)])


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_prior_that_weighs_roundings_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    prior = blindspot.laplacian_prior
    monkeypatch.setattr(HERE, "laplacian_prior", lambda images: prior(images.bfloat16().float()))
    assert fails("one pixel one 16-bit step above a flat image")
    noisy = lambda images: prior(images + 1e-7 * torch.rand(images.shape))  # noqa: E731
    monkeypatch.setattr(HERE, "laplacian_prior", noisy)
    assert fails("flat images: the prior is uniform")


def test_a_replacement_by_the_pixel_itself_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HERE, "replace_masked", lambda images, mask, window, generator: images.clone())
    assert fails("borders: replacements lie in the window and are never the pixel itself")
    assert fails("the centre never leaks: the blinded picture")
    assert fails("the centre never leaks: through the network")
    assert fails("an image of one pixel")


def test_a_blur_with_its_centre_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    blur = blindspot.F.avg_pool2d
    monkeypatch.setattr(HERE, "donut_blur", lambda images, sigma: blur(images, 3, 1, 1, count_include_pad=False))
    assert fails("the centre never leaks: the blur that is predicted from")


def test_a_mask_of_another_size_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HERE, "sample_mask", lambda images, *rest: torch.ones(images[:, 0].shape).bool())
    assert fails("more blind spots asked for than there are pixels")


def test_a_running_sum_of_squares_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def running(prediction, noisy, mask):
        squared = ((prediction - noisy) ** 2).sum(1)[mask]
        return torch.cumsum(squared, 0)[-1] / mask.sum() * (1 + 1e-5)

    monkeypatch.setattr(HERE, "n2v_loss", running)
    assert fails("the loss over a quarter million spots")


def test_a_slope_that_is_nan_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.autograd, "grad", lambda outputs, noisy: (noisy.detach() * torch.nan,))
    assert fails("the centre never leaks: through the network")
