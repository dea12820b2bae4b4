"""Files of networks in training, as safetensors.

Networks that learn beside a fit keep the fit's own checkpoint in the same file: the two then always belong together.
"""

from pathlib import Path

import torch
from torch import Tensor

from sensor_model.files.atomic import atomic
from sensor_model.files.door import read_bytes


def file_as_tensor(path: Path) -> Tensor:
    """The bytes of a file, uint8."""
    return torch.frombuffer(bytearray(read_bytes(path)), dtype=torch.uint8)


def tensor_as_file(content: Tensor, path: Path) -> None:
    """Write the bytes that `file_as_tensor` read; the file appears whole or not at all."""
    with atomic(path) as temporary:
        temporary.write_bytes(content.numpy().tobytes())
