"""Every writer on a full disk."""

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from novags.splats import Gaussians, write_ply
from novags.splats.training.checkpoint import write_tensors
from sensor_model.files.atomic import write_text
from simscenes import write_exr
from simscenes.sets.pictures.png import write_png


@contextmanager
def no_file_beyond(size: int) -> Iterator[None]:
    """Writing more bytes to a file fails, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("writer", "message"),
    [
        ("exr", r"cannot write .*file\.exr: .*File too large"),
        ("tensors", r"cannot write .*file\.tensors: .*File too large"),
        ("png", r"cannot write .*file\.png"),
        ("ply", r"File too large: '.*file\.ply'"),
        ("text", r"File too large: '.*file\.text'"),
    ],
)
def test_a_full_disk_is_an_os_error_and_leaves_no_half_file(writer: str, message: str, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).random((64, 64, 3), dtype=np.float32)
    gaussians = Gaussians.from_points(torch.from_numpy(noise[0]), torch.from_numpy(noise[1]), sh_degree=1)
    write: dict[str, Callable[[Path], object]] = {
        "exr": lambda path: write_exr(path, {"R": noise[..., 0]}),
        "tensors": lambda path: write_tensors(path, {"a": torch.from_numpy(noise)}),
        "png": lambda path: write_png(path, noise),
        "ply": lambda path: write_ply(path, gaussians),
        "text": lambda path: write_text(path, "x" * 5000),
    }
    with no_file_beyond(4096), pytest.raises(OSError, match=message):
        write[writer](tmp_path / f"file.{writer}")
    assert not list(tmp_path.iterdir())
