"""Scores: pure functions of arrays that compare the results of a method with the truth.

`METRICS` names the scores of pictures; `images` holds ours and computes all, `tone` aligns pictures first, `perceptual`
is LPIPS, `st_lpips` a relative of it whose weights come in a package, `challenge` has the scores of a published
protocol. `linear` compares light, `geometry` depth,
`consistency` one view with another, `noise` finds the noise left.
"""

from collections.abc import Mapping

from novags.testbed.metrics.metric import Metric
from sensor_model.files.registry import Registry

METRICS: Registry[Metric] = Registry(
    {
        "aligned_psnr": "novags.testbed.metrics.images:ALIGNED_PSNR",
        "tone_aligned_psnr": "novags.testbed.metrics.images:TONE_ALIGNED_PSNR",
        "psnr": "novags.testbed.metrics.images:PSNR",
        "aligned_ssim": "novags.testbed.metrics.images:ALIGNED_SSIM",
        "tone_aligned_ssim": "novags.testbed.metrics.images:TONE_ALIGNED_SSIM",
        "ssim": "novags.testbed.metrics.images:SSIM",
        "flip": "novags.testbed.metrics.images:FLIP",
        "delta_e": "novags.testbed.metrics.images:DELTA_E",
        "lpips": "novags.testbed.metrics.perceptual:LPIPS",
        "st_lpips": "novags.testbed.metrics.st_lpips:ST_LPIPS",
        "jpeg_psnr": "novags.testbed.metrics.challenge:JPEG_PSNR",
        "jpeg_ssim": "novags.testbed.metrics.challenge:JPEG_SSIM",
    },
    "novags.metrics",
    Metric,
)


def modules() -> list[str | None]:
    """The modules of all rows that can be used: each score belongs to the code of every scored run."""
    return [METRICS.module_of(name) for name, _ in METRICS.items()]


def missing(width: int | None = None, height: int | None = None) -> Mapping[str, str]:
    """Why scores by networks cannot be computed here, of pictures of a size if one is given, by their names."""
    asked = {name: metric.missing(width, height) for name, metric in METRICS.items() if metric.missing is not None}
    return {name: why for name, why in asked.items() if why is not None}


def networks() -> set[str]:
    """The names of the scores by networks."""
    return {name for name, metric in METRICS.items() if metric.missing is not None}


def protocol_of(dataset: str | None) -> set[str]:
    """The names of the scores that the protocol of a published data set asks for."""
    return {name for name, metric in METRICS.items() if metric.protocol and metric.protocol == dataset}
