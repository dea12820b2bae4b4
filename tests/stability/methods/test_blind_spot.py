from collections.abc import Callable

import pytest
import torch

from novags.methods.nova import blindspot
from novags.testbed.stability import Case, Setting, measured
from novags.testbed.stability.parts.methods import blind_spot

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_prior_that_weighs_roundings_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    prior = blindspot.laplacian_prior
    monkeypatch.setattr(blind_spot, "laplacian_prior", lambda images: prior(images.bfloat16().float()))
    assert fails("one pixel one 16-bit step above a flat image")
    noisy = lambda images: prior(images + 1e-7 * torch.rand(images.shape))  # noqa: E731
    monkeypatch.setattr(blind_spot, "laplacian_prior", noisy)
    assert fails("flat images: the prior is uniform")


def test_a_replacement_by_the_pixel_itself_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blind_spot, "replace_masked", lambda images, mask, window, generator: images.clone())
    assert fails("borders: replacements lie in the window and are never the pixel itself")
    assert fails("the centre never leaks: the blinded picture")
    assert fails("the centre never leaks: through the network")
    assert fails("an image of one pixel")


def test_a_blur_with_its_centre_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    blur = blindspot.F.avg_pool2d
    monkeypatch.setattr(blind_spot, "donut_blur", lambda images, sigma: blur(images, 3, 1, 1, count_include_pad=False))
    assert fails("the centre never leaks: the blur that is predicted from")


def test_a_mask_of_another_size_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blind_spot, "sample_mask", lambda images, *rest: torch.ones(images[:, 0].shape).bool())
    assert fails("more blind spots asked for than there are pixels")


def test_a_running_sum_of_squares_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def running(prediction, noisy, mask):
        squared = ((prediction - noisy) ** 2).sum(1)[mask]
        return torch.cumsum(squared, 0)[-1] / mask.sum() * (1 + 1e-5)

    monkeypatch.setattr(blind_spot, "n2v_loss", running)
    assert fails("the loss over a quarter million spots")


def test_a_slope_that_is_nan_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.autograd, "grad", lambda outputs, noisy: (noisy.detach() * torch.nan,))
    assert fails("the centre never leaks: through the network")
