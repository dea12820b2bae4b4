"""Claims about the scores of the challenge on RealX3D: of a picture read back from a JPEG file, of no other data."""

import io

import numpy as np
import pytest
from PIL import Image

from novags.testbed.metrics import METRICS, protocol_of
from novags.testbed.metrics.challenge import as_jpeg, jpeg_psnr, jpeg_ssim
from novags.testbed.metrics.images import image_scores, psnr, ssim


def smooth(seed: int) -> np.ndarray:
    y, x = np.mgrid[:48, :64] / 16
    waves = [np.sin(x * (1 + c / 3) + seed) * np.cos(y + c) for c in range(3)]
    return (0.5 + 0.4 * np.stack(waves, -1)).astype(np.float32)


def test_a_picture_is_what_another_program_reads_from_such_a_file() -> None:
    """Independent: Pillow writes and reads; its coder rounds differently, by a code or two."""
    image = smooth(0)
    file = io.BytesIO()
    Image.fromarray(np.rint(255 * image).astype(np.uint8)).save(file, "JPEG", quality=95)
    theirs = np.asarray(Image.open(file)).astype(np.float64)
    ours = 255 * as_jpeg(image).astype(np.float64)
    assert np.abs(ours - theirs).mean() < 0.5
    assert np.abs(ours - theirs).max() <= 4
    assert 0.1 < np.abs(ours - 255 * image).mean() < 2  # something is lost, and little


def test_scores_are_those_of_the_picture_in_the_file_without_alignment() -> None:
    image, reference = 1.2 * smooth(0), smooth(1)
    assert jpeg_psnr(image, reference) == psnr(as_jpeg(image), reference)
    assert jpeg_ssim(image, reference) == ssim(as_jpeg(image), reference)
    exact = np.rint(255 * smooth(1)).astype(np.float32) / 255
    assert 35 < jpeg_psnr(exact, exact) < 60  # a file costs something even where nothing is wrong


def test_they_are_computed_where_the_protocol_asks_for_them_alone() -> None:
    image, reference = smooth(0), smooth(1)
    assert protocol_of("RealX3D") == {"jpeg_psnr", "jpeg_ssim"}
    assert protocol_of(None) == protocol_of("LOM") == set()
    assert not {"jpeg_psnr", "jpeg_ssim"} & image_scores(image, reference).keys()
    assert image_scores(image, reference, ("jpeg_psnr",))["jpeg_psnr"] == pytest.approx(jpeg_psnr(image, reference))
    assert METRICS["jpeg_psnr"].more
