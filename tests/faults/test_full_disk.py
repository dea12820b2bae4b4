"""Every writer on a full disk."""

import errno
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from novags.splats import Gaussians, write_ply
from novags.splats.files.tensors import write_tensors
from sensor_model.files.atomic import write_text
from simscenes import orbit_rig, write_exr
from simscenes.job.finish import view_store
from simscenes.sets.pictures.png import write_png
from simscenes.sets.writers.neighbours import write_depth


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
        ("png", r"File too large: '.*file\.png'"),
        ("depth", r"File too large: '.*file\.depth'"),
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
        "depth": lambda path: write_depth(path, 60 * noise[..., 0]),
        "ply": lambda path: write_ply(path, gaussians),
        "text": lambda path: write_text(path, "x" * 5000),
    }
    with no_file_beyond(4096), pytest.raises(OSError, match=message):
        write[writer](tmp_path / f"file.{writer}")
    assert not list(tmp_path.iterdir())


def test_what_a_render_keeps_of_its_views_says_that_the_disk_is_full(tmp_path: Path) -> None:
    """Rationale: np.save gives no reason, so that a study took a full disk for a fault of the scene."""
    light = np.ones((64, 64), np.float32)
    with view_store(tmp_path, orbit_rig(3, 64, 64, 50.0, radius=3.0), None) as store, no_file_beyond(4096):
        with pytest.raises(OSError, match="File too large") as raised:
            store.put(0, dict.fromkeys(("R", "G", "B", "Z"), light))
    assert raised.value.errno == errno.EFBIG
