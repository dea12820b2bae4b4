"""What is written appears whole or not at all."""

import resource

import numpy as np
import pytest

from sensor_model import PRESETS, Exposure, write_dng, write_sensor

SENSOR = PRESETS["imx900-hcg"]
WRITERS = {
    "dng": lambda path: write_dng(path, np.zeros((64, 64), np.uint16), SENSOR, Exposure(time=0.02)),
    "toml": lambda path: write_sensor(path, SENSOR, comment="full\n" * 1000),
}


@pytest.mark.parametrize("kind", list(WRITERS))
def test_a_full_disk_is_an_os_error_and_leaves_what_was_there(kind, tmp_path):
    path = tmp_path / f"file.{kind}"
    path.write_text("before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(OSError, match=f"File too large: '{path}'"):
            WRITERS[kind](path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "before"
    WRITERS[kind](path)
    assert path.stat().st_size > 4096
