from collections.abc import Callable

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.nova import sh_penalty as penalties
from novags.splats.training import losses
from novags.testbed.stability import Case, Setting, measured

Fails = Callable[..., bool]


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def test_a_score_without_its_constants_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def loss(image: Tensor, target: Tensor, share: float) -> Tensor:
        return (1 - share) * F.l1_loss(image, target) + share * (1 - losses.ssim(image, target))

    monkeypatch.setattr(losses, "photometric_loss", loss)
    assert not fails("pictures: black, white, blank, equal, one bright pixel", "numba")
    monkeypatch.setattr(losses, "C1", 0.0)
    monkeypatch.setattr(losses, "C2", 0.0)
    assert fails("pictures: black, white, blank, equal, one bright pixel", "numba")


def test_moments_of_half_the_digits_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = losses.photometric_loss
    monkeypatch.setattr(losses, "photometric_loss", lambda x, y, share: plain(x.bfloat16().float(), y, share))
    assert fails("texture of one 8-bit step on a bright picture", "numba")


def test_windows_that_mirror_the_border_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def blurred(images: Tensor) -> Tensor:
        weights = losses._kernel(images.dtype).outer(losses._kernel(images.dtype))[None, None]
        return F.conv2d(F.pad(images[:, None], (5, 5, 5, 5), mode="replicate"), weights)[:, 0]

    def loss(image: Tensor, target: Tensor, share: float) -> Tensor:
        return (1 - share) * F.l1_loss(image, target) + share * (1 - losses.ssim(image, target))

    monkeypatch.setattr(losses, "photometric_loss", loss)
    monkeypatch.setattr(losses, "_blur", blurred)
    assert fails("pictures of one to nine pixels", "numba")


def test_a_mean_over_nobody_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def penalty(sh: Tensor, means2d: Tensor, radii: Tensor, noise: Tensor) -> Tensor:
        seen = radii > 0
        return (penalties.noise_weights(noise, means2d)[seen] * sh[seen, 1:].square().sum((1, 2))).mean()

    monkeypatch.setattr(penalties, "sh_penalty", penalty)
    assert fails("harmonics: nobody visible, degree 0, a picture of one pixel")
    assert fails("harmonics of 1e-15 to 1e15, noise of 0 to 1, at borders and corners")


def test_noise_read_half_a_pixel_away_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = penalties.noise_weights
    monkeypatch.setattr(penalties, "noise_weights", lambda noise, means: plain(noise, torch.sub(means, 0.5)))
    assert fails("harmonics of 1e-15 to 1e15, noise of 0 to 1, at borders and corners")
