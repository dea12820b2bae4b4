"""EXR files keep every bit of every channel."""

from pathlib import Path

import numpy as np
import pytest

from simscenes.sets.pictures.exr import read_exr, write_exr


def test_channels_and_header_come_back_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    channels = {
        "R": rng.lognormal(0, 8, (7, 5)).astype(np.float32),
        "Z": np.full((7, 5), np.inf, dtype=np.float32),
        "N.X": -rng.random((7, 5)).astype(np.float32),
        "id": rng.integers(0, 2**32, (7, 5), dtype=np.uint32),
        "half": rng.random((7, 5)).astype(np.float16),
    }
    before = {k: v.copy() for k, v in channels.items()}
    pose = rng.random((4, 4)).astype(np.float32)
    write_exr(tmp_path / "a.exr", channels, {"worldToCamera": pose, "key": "abc", "count": 3})
    read, header = read_exr(tmp_path / "a.exr")
    assert read.keys() == before.keys()
    for name, values in before.items():
        assert np.array_equal(channels[name], values)  # the caller's dict is left alone
        assert read[name].dtype == values.dtype
        assert np.array_equal(read[name], values)
    assert np.array_equal(header["worldToCamera"], pose)
    assert (header["key"], header["count"]) == ("abc", 3)


def test_one_pixel_and_rgb_names_survive(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {c: np.full((1, 1), k, np.float32) for k, c in enumerate("RGB")})
    assert {c: float(v[0, 0]) for c, v in read_exr(tmp_path / "a.exr")[0].items()} == {"R": 0, "G": 1, "B": 2}


@pytest.mark.parametrize(
    "channels",
    [
        {},
        {"R": np.zeros((2, 2))},
        {"R": np.zeros((2, 2), "f4"), "G": np.zeros((2, 3), "f4")},
        {"R": np.zeros((0, 2), "f4")},
    ],
)
def test_what_exr_cannot_hold_is_refused(channels: dict, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="write_exr"):
        write_exr(tmp_path / "a.exr", channels)
    assert list(tmp_path.iterdir()) == []


def test_a_cut_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {"R": np.random.default_rng(0).random((64, 64)).astype(np.float32)})
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"a\.exr"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(ValueError, match="no such file"):
        read_exr(tmp_path / "b.exr")


def test_half_precision_never_overflows_silently(tmp_path: Path) -> None:
    with np.errstate(over="ignore"):
        half = np.array([[65504.0, 70000.0]]).astype(np.float16)
    write_exr(tmp_path / "a.exr", {"R": half[:, :1]})
    with pytest.raises(ValueError, match="float16"):
        write_exr(tmp_path / "b.exr", {"R": half})
