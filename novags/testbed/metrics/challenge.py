"""Scores as the entries of the NTIRE 2026 challenge on RealX3D compute them: of the picture as an 8-bit JPEG file.

A picture is written at quality 95 and read back, and no colour is aligned. The page of the challenge names PSNR and
SSIM and shows no code; the detour through a file is one entrant's (Naka-GS), and the tables of its readers have it.
"""

import numpy as np

from novags.testbed.metrics.images import psnr, ssim
from novags.testbed.metrics.metric import Metric
from novags.testbed.metrics.picture import Image

QUALITY = 95
PROTOCOL = "RealX3D"


def as_jpeg(image: Image) -> Image:
    """A picture [h,w,3], sRGB code in 0..1, as it is read back from a JPEG file of quality 95, float32."""
    import cv2  # here: `novags list` asks each metric for its name

    codes = np.rint(255 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    _, content = cv2.imencode(".jpg", codes[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    found = np.asarray(cv2.imdecode(content, cv2.IMREAD_COLOR))[..., ::-1]
    return np.ascontiguousarray(found).astype(np.float32) / np.float32(255)


def jpeg_psnr(image: Image, reference: Image) -> float:
    """PSNR of a picture after `as_jpeg`, dB."""
    return psnr(as_jpeg(image), reference)


def jpeg_ssim(image: Image, reference: Image) -> float:
    """SSIM of a picture after `as_jpeg`."""
    return ssim(as_jpeg(image), reference)


JPEG_PSNR = Metric(
    heading="PSNR as JPEG", score=jpeg_psnr, more=True, unit="dB", digits=2, in_studies=False, protocol=PROTOCOL
)
JPEG_SSIM = Metric(heading="SSIM as JPEG", score=jpeg_ssim, more=True, in_studies=False, protocol=PROTOCOL)
