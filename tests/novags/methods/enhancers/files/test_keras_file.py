"""Files of Keras: every array by its path, and damaged ones in one line."""

import struct

import numpy as np
import pytest

from novags.methods.enhancers.files.keras_file import read_keras
from novags.methods.enhancers.files.weights import read_weights
from tests.fuzz.readers.keras import keras_bytes


def test_keras_files_are_read_by_path(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {"a/a/kernel:0": rng.random((3, 3, 2, 4)), "a/a/bias:0": rng.random(4), "b": rng.random((2, 5))}
    (tmp_path / "w.h5").write_bytes(keras_bytes(arrays))
    found = read_weights((tmp_path / "w.h5",))
    assert found.keys() == arrays.keys()
    for name, value in arrays.items():
        np.testing.assert_array_equal(found[name], value.astype(np.float32))


def test_every_cut_of_a_keras_file_and_a_group_in_itself_is_one_line(tmp_path):
    whole = bytearray(keras_bytes({"a/kernel:0": np.ones((2, 3)), "b": np.ones(2)}))
    needed = whole.rindex(b"TREE")  # the root's; what follows it are its header's two numbers
    for end in range(0, needed + 24, 7):
        with pytest.raises(ValueError, match="ends too early|points to byte|not an HDF5|no |bytes at byte|version"):
            read_keras(bytes(whole[:end]))
    root = int.from_bytes(whole[64:72], "little")
    leaf = whole.rindex(b"SNOD")
    whole[leaf + 16 : leaf + 24] = root.to_bytes(8, "little")
    with pytest.raises(ValueError, match="contain one another"):
        read_keras(bytes(whole))


def test_an_object_whose_messages_go_on_elsewhere_is_read_as_a_whole():
    values = np.arange(6.0).reshape(2, 3)
    whole = bytearray(keras_bytes({"a": values}))
    layout = whole.index(struct.pack("<HHB3x", 8, 24, 0))  # the last message of its header
    message = whole[layout : layout + 32]
    whole[layout : layout + 24] = struct.pack("<HHB3xQQ", 16, 24, 0, len(whole), len(message))
    np.testing.assert_array_equal(read_keras(bytes(whole + message))["a"], values)
