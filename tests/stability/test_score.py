"""Every hard case of the scores holds; and with each score as one would first write it, its case does not."""

from typing import Any

import numpy as np
import pytest
import torch
from torchmetrics.functional.image import structural_similarity_index_measure

from novags.testbed.metrics import images, tone
from novags.testbed.stability import PARTS, Case, Setting, measured
from novags.testbed.stability.parts import score as cases


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


def without_ceiling(image: Any, reference: Any) -> float:
    with np.errstate(divide="ignore"):
        return float(-10 * np.log10(np.mean((image - reference) ** 2)))


def ssim_over_the_range_of_the_pictures(image: Any, reference: Any) -> float:
    a, b = (torch.from_numpy(x.transpose(2, 0, 1)[None].copy()) for x in (image, reference))
    return float(structural_similarity_index_measure(a, b))


def fitted_whatever_the_contrast(image: Any, reference: Any) -> Any:
    with np.errstate(all="ignore"):
        x, y = image.reshape(-1, 3), reference.reshape(-1, 3)
        gain = ((x * y).mean(0) - x.mean(0) * y.mean(0)) / ((x * x).mean(0) - x.mean(0) ** 2)
        return gain * (image - x.mean(0)) + y.mean(0)


def sorted_curve(image: Any, reference: Any) -> Any:
    """Isotonic regression in the order of a sort, which splits equal values."""
    from scipy.optimize import isotonic_regression

    out = np.empty(image.shape)
    for c in range(3):
        order = np.argsort(image[..., c].ravel(), kind="stable")
        plane = np.empty(order.size)
        plane[order] = isotonic_regression(reference[..., c].ravel()[order].astype(float)).x
        out[..., c] = plane.reshape(image.shape[:2])
    return out


def every_pixel(depth: Any, alpha: Any, truth: Any) -> dict[str, float]:
    with np.errstate(all="ignore"):
        error = np.abs(depth / truth - 1)
    return {"abs_rel": float(error.mean()), "within_5_percent": 1.0, "coverage": 1.0, "floaters": 0.0}


@pytest.mark.parametrize(
    ("module", "name", "naive", "start"),
    [
        (images, "_psnr", without_ceiling, "equal pictures"),
        (images, "_psnr", without_ceiling, "PSNR of errors"),
        (images, "_ssim", ssim_over_the_range_of_the_pictures, "SSIM of blank"),
        (cases, "affine_aligned", fitted_whatever_the_contrast, "affine fit of a blank"),
        (cases, "affine_aligned", fitted_whatever_the_contrast, "affine fit of a contrast"),
        (cases, "tone_aligned", sorted_curve, "monotone curve"),
        (images, "with_contrast", lambda reference: np.ones(3, bool), "a blank reference"),
        (images, "with_contrast", lambda reference: np.ones(3, bool), "one channel"),
        (tone, "np", None, "nan and infinite"),
        (cases, "exposure_gain", lambda pairs: float((pairs[0][0] * pairs[0][1]).sum() / (pairs[0][0] ** 2).sum()),
         "linear light"),
        (cases, "geometry_scores", every_pixel, "pixels that nobody sees"),
    ],
)  # fmt: skip
def test_a_score_as_first_written_exceeds_its_bound(
    module: Any, name: str, naive: Any, start: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (case,) = [case for case in PARTS["score"].cases if case.name.startswith(start)]
    setting = case.settings()[0]
    assert measured(case, setting).holds
    if name == "np":  # the check for NaN and infinity, taken out wherever it was imported
        for user in (tone, images):
            monkeypatch.setattr(user, "check_pair", lambda image, reference: None)
    else:
        monkeypatch.setattr(module, name, naive)
    with np.errstate(all="ignore"):
        assert not measured(case, setting).holds
