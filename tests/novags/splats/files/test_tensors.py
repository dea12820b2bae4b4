"""Claims about tensors on disk."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from novags.cameras.networks.package import read_checkpoint
from novags.methods.enhancers.files.weights import read_weights
from novags.splats.files.tensors import check_lengths, digest

DIRECTORY, SIZE = b"PK\x01\x02", 24  # of a zip file: an entry of its table, and where that says the length of its part


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "w.pt"
    torch.save({"a": torch.arange(6.0)}, path)
    return path


def test_a_whole_file_is_read(weights: Path) -> None:
    check_lengths(weights)
    assert torch.equal(read_checkpoint(weights)["a"], torch.arange(6.0))


@pytest.mark.parametrize("read", [check_lengths, read_checkpoint, lambda path: read_weights([path])])
def test_a_part_that_announces_more_than_the_file_holds_is_refused_before_memory_is_reserved(
    weights: Path, read: Callable[[Path], object]
) -> None:
    content = bytearray(weights.read_bytes())
    first = content.index(DIRECTORY)
    content[first + SIZE : first + SIZE + 4] = struct.pack("<I", 0xFF000000)
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=rf"has {len(content)} bytes, and .* in it announces 4278190080"):
        read(weights)


def test_a_damaged_table_of_parts_is_refused_and_an_old_file_has_none(weights: Path) -> None:
    torch.save({"a": torch.ones(2)}, weights.with_name("old.pt"), _use_new_zipfile_serialization=False)
    check_lengths(weights.with_name("old.pt"))
    content = weights.read_bytes()
    weights.write_bytes(content.replace(DIRECTORY, b"PK\x01\x03", 1))
    with pytest.raises(ValueError, match="the table of its parts is damaged"):
        check_lengths(weights)


def test_tensors_of_another_kind_shape_number_or_order_have_another_digest():
    numbers = torch.arange(6, dtype=torch.int32)
    kinds = [
        digest(numbers), digest(numbers.view(torch.float32)), digest(numbers.reshape(2, 3)), digest(numbers.flip(0)),
        digest(numbers, numbers), digest(numbers[:3], numbers[3:]), digest(numbers[3:], numbers[:3]),
    ]  # fmt: skip
    assert len(set(kinds)) == len(kinds)
    assert digest(numbers.reshape(2, 3).T.contiguous().T) == digest(numbers.reshape(2, 3))  # however it lies in memory
