"""A writer of the one HDF5 layout that Keras 2 has, as small as it can be, so that tests need no library for it."""

from __future__ import annotations

import struct

import numpy as np

NOWHERE = 2**64 - 1


class _Writer:
    def __init__(self) -> None:
        # superblock of version 0; the root's object header (at 72) and the end of the file follow when they are known
        self.content = bytearray(b"\x89HDF\r\n\x1a\n" + bytes([0, 0, 0, 0, 0, 8, 8, 0]) + struct.pack("<HHI", 4, 16, 0))
        self.content += struct.pack("<QQQQ", 0, NOWHERE, 0, NOWHERE) + bytes(40)

    def add(self, block: bytes) -> int:
        self.content += bytes(-len(self.content) % 8)
        place = len(self.content)
        self.content += block
        return place

    def header(self, *messages: tuple[int, bytes]) -> int:
        body = b"".join(
            struct.pack("<HHB3x", kind, len(data) + (-len(data) % 8), 0) + data + bytes(-len(data) % 8)
            for kind, data in messages
        )
        return self.add(struct.pack("<BxHII4x", 1, len(messages), 1, len(body)) + body)

    def array(self, values: np.ndarray) -> int:
        values = np.ascontiguousarray(values, "<f4")
        place = self.add(values.tobytes())
        space = struct.pack("<BBB5x", 1, values.ndim, 0) + struct.pack(f"<{values.ndim}Q", *values.shape)
        kind = bytes([0x11, 0x20, 0x1F, 0]) + struct.pack("<IHHBBBBI", 4, 0, 32, 23, 8, 0, 23, 127)
        return self.header((1, space), (3, kind), (8, struct.pack("<BBQQ", 3, 1, place, values.nbytes)))

    def group(self, children: dict[str, int]) -> int:
        names, offsets = bytearray(8), {}
        for name in sorted(children):
            offsets[name] = len(names)
            names += name.encode() + bytes(8 - len(name) % 8)
        heap = self.add(b"HEAP" + struct.pack("<I", 0) + struct.pack("<QQ", len(names), 1))
        self.content += struct.pack("<Q", heap + 32) + names
        entries = b"".join(struct.pack("<QQII16x", offsets[name], children[name], 0, 0) for name in sorted(children))
        leaf = self.add(b"SNOD" + struct.pack("<BBH", 1, 0, len(children)) + entries)
        tree = self.add(b"TREE" + struct.pack("<BBHQQ", 0, 0, 1, NOWHERE, NOWHERE) + struct.pack("<QQQ", 0, leaf, 8))
        return self.header((0x11, struct.pack("<QQ", tree, heap)))


def keras_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """A file with these data sets, by path."""
    writer = _Writer()

    def add(prefix: str) -> int:
        below = [path.removeprefix(prefix) for path in arrays if path.startswith(prefix)]
        children = {}
        for name in dict.fromkeys(path.partition("/")[0] for path in below):
            whole = prefix + name
            children[name] = writer.array(arrays[whole]) if whole in arrays else add(f"{whole}/")
        return writer.group(children)

    root = add("")
    struct.pack_into("<Q", writer.content, 40, len(writer.content))
    struct.pack_into("<QQ", writer.content, 56, 0, root)
    return bytes(writer.content)
