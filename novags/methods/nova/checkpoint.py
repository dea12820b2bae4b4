"""Files of networks in training, as safetensors.

Networks that learn beside a fit keep the fit's own checkpoint in the same file: the two then always belong together.
"""

from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor

from sensor_model.files.atomic import atomic
from sensor_model.files.door import admitted, read_bytes
from sensor_model.files.reading import brief


def read(path: Path) -> dict[str, Tensor]:
    """The tensors `write_tensors` saved.

    Raises:
        ValueError: If the file is not a safetensors file.
    """
    try:
        return load_file(admitted(path))
    except Exception as error:  # safetensors raises its own class, which it does not promise to keep
        raise ValueError(f"{path} is damaged ({brief(error)}): delete it, the run then starts over") from error


def file_as_tensor(path: Path) -> Tensor:
    """The bytes of a file, uint8."""
    return torch.frombuffer(bytearray(read_bytes(path)), dtype=torch.uint8)


def tensor_as_file(content: Tensor, path: Path) -> None:
    """Write the bytes that `file_as_tensor` read; the file appears whole or not at all."""
    with atomic(path) as temporary:
        temporary.write_bytes(content.numpy().tobytes())
