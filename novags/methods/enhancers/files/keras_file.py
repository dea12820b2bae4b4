"""Weights that Keras saved as HDF5, read without a library: the one layout that Keras 2 writes, and nothing else.

The format follows the "HDF5 File Format Specification Version 2.0": superblock 0, groups as B-trees of version 1,
object headers of version 1, and contiguous data sets of little-endian IEEE floats. A C library would read more, and
break in C on damaged files.
"""

import struct
from typing import Any

import numpy as np
import torch
from torch import Tensor

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SPACE, TYPE, LAYOUT, CONTINUED, GROUP = 0x01, 0x03, 0x08, 0x10, 0x11  # messages of an object header
MOST, DEEPEST = 10_000, 8  # objects of a file, groups in one another


def read_keras(content: bytes) -> dict[str, Tensor]:
    """Data sets by path: "conv2d_1/conv2d_1/kernel:0" -> float32.

    Raises:
        ValueError: If the content is damaged, or of another layout.
    """
    try:
        return _KerasFile(content).tensors()
    except struct.error as error:
        raise ValueError(f"it ends too early ({error})") from error


class _KerasFile:
    def __init__(self, content: bytes) -> None:
        self.content = content
        self.seen: set[int] = set()
        if not content.startswith(SIGNATURE) or self.at("<8xB4xBB", 0) != (0, 8, 8):
            raise ValueError("it is not an HDF5 file with a superblock of version 0")

    def at(self, form: str, place: int) -> tuple[Any, ...]:
        """Numbers at a place."""
        if not 0 <= place <= len(self.content):
            raise ValueError(f"it points to byte {place} of {len(self.content)}")
        return struct.unpack_from(form, self.content, place)

    def tensors(self) -> dict[str, Tensor]:
        """All tensors of the file by name; the root's entry begins at byte 56."""
        return self.object(self.at("<Q", 56 + 8)[0], "", 0)

    def object(self, place: int, path: str, depth: int) -> dict[str, Tensor]:
        """A data set, or the data sets in a group; each object is read once, so that a circle ends."""
        if place in self.seen or len(self.seen) > MOST or depth > DEEPEST:
            raise ValueError("its groups contain one another, or are too many")
        self.seen.add(place)
        messages = self.messages(place)
        if GROUP in messages:
            tree, heap = self.at("<QQ", messages[GROUP])
            if self.content[heap : heap + 4] != b"HEAP":
                raise ValueError(f"byte {heap} must begin a heap of names, and does not")
            names = self.at("<24xQ", heap)[0]
            found: dict[str, Tensor] = {}
            for name, child in self.entries(tree, names, 0):
                found |= self.object(child, f"{path}/{name}" if path else name, depth + 1)
            return found
        return {path: self.array(messages)} if LAYOUT in messages else {}

    def messages(self, place: int) -> dict[int, int]:
        """Kinds of messages in an object header -> where their content begins."""
        version, _, length = self.at("<BxH4xI", place)
        if version != 1:
            raise ValueError(f"an object header has version {version}, 1 is read")
        found: dict[int, int] = {}
        blocks: list[tuple[int, ...]] = [(place + 16, length)]
        for start, size in blocks:
            end = min(start + size, len(self.content))
            while start + 8 <= end:
                kind, content = self.at("<HH", start)
                if kind == CONTINUED:
                    blocks.append(self.at("<QQ", start + 8))
                    if len(blocks) > 100:
                        raise ValueError("an object header is continued too often")
                found.setdefault(kind, start + 8)
                start += 8 + content
        return found

    def entries(self, place: int, names: int, depth: int) -> list[tuple[str, int]]:
        """Names in a group and where their objects are, from its B-tree."""
        if self.content[place : place + 4] == b"SNOD":
            return [self.entry(place + 8 + 40 * i, names) for i in range(self.at("<6xH", place)[0])]
        kind, used = self.at("<4xBxH", place)
        if self.content[place : place + 4] != b"TREE" or kind != 0 or depth > DEEPEST:
            raise ValueError(f"byte {place} must begin a group, and does not")
        children = [self.at("<Q", place + 32 + 16 * i)[0] for i in range(used)]
        found = [entry for child in children for entry in self.entries(child, names, depth + 1)]
        if len(found) > MOST:
            raise ValueError("a group has too many entries")
        return found

    def entry(self, place: int, names: int) -> tuple[str, int]:
        """The name and the object of one entry."""
        name, target = self.at("<QQ", place)
        begin = names + name
        end = self.content.find(b"\0", begin, begin + 500)
        if begin >= len(self.content) or end < 0:
            raise ValueError(f"an entry at byte {place} has no name")
        return self.content[begin:end].decode("ascii", "replace"), target

    def array(self, messages: dict[int, int]) -> Tensor:
        """A data set."""
        version, rank = self.at("<BB", messages[SPACE])
        if version not in (1, 2) or rank > 8:
            raise ValueError(f"a data space has version {version} and {rank} dimensions")
        shape = self.at(f"<{rank}Q", messages[SPACE] + (8 if version == 1 else 4))
        kind, order, size = self.at("<BB2xI", messages[TYPE])
        layout, how, place, count = self.at("<BBQQ", messages[LAYOUT])
        if kind & 15 != 1 or order & 1 or size != 4 or (layout, how) != (3, 1):
            raise ValueError("it holds other data than contiguous little-endian float32")
        wanted = 4 * int(np.prod([float(side) for side in shape]))
        if count != wanted or place + count > len(self.content):
            raise ValueError(f"a data set of shape {list(shape)} has {count} bytes at byte {place}")
        values = np.frombuffer(self.content, "<f4", count // 4, place).reshape(shape)
        return torch.from_numpy(values.astype(np.float32))
