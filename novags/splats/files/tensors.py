"""Tensors on disk: safetensors, never pickle."""

import hashlib
import zipfile
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from sensor_model.files.atomic import atomic
from sensor_model.files.door import admitted, opened
from sensor_model.files.reading import brief


def digest(*tensors: Tensor) -> str:
    """Sixteen hexadecimal digits that differ for tensors of other values, shapes or dtypes."""
    sums = hashlib.sha256()
    for tensor in tensors:
        sums.update(f"{tensor.dtype} {list(tensor.shape)} ".encode())
        sums.update(tensor.detach().cpu().contiguous().numpy().data)
    return sums.hexdigest()[:16]


def write_tensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str] | None = None) -> None:
    """Write a safetensors file that appears whole or not at all.

    Raises:
        OSError: If it cannot be written, for a full disk for example.
    """
    try:
        with atomic(path) as temporary:
            save_file({name: t.contiguous() for name, t in tensors.items()}, temporary, metadata=metadata)
    except SafetensorError as error:  # how safetensors reports a full disk, for example
        raise OSError(f"cannot write {path}: {error}") from error


def read(path: Path) -> dict[str, Tensor]:
    """The tensors that `write_tensors` saved.

    Raises:
        ValueError: If the file is not a safetensors file.
    """
    try:
        return load_file(admitted(path))
    except Exception as error:  # safetensors raises its own class, which it does not promise to keep
        raise ValueError(f"{path} is damaged ({brief(error)}): delete it, the run then starts over") from error


def check_lengths(path: Path) -> None:
    """Refuse a file of `torch.save` if a part of it announces more than the file holds.

    Rationale: torch reserves the announced size before it looks, gigabytes for a file of a kilobyte.

    Raises:
        ValueError: If it does, or the table of its parts is damaged.
    """
    with opened(path) as file:
        if not zipfile.is_zipfile(file):  # as torch wrote before 1.6
            return
        try:
            parts = zipfile.ZipFile(file).infolist()
        except (
            zipfile.BadZipFile,
            NotImplementedError,
        ) as error:  # the latter: not of torch's
            raise ValueError(f"{path}: the table of its parts is damaged ({error})") from error
        size = file.seek(0, 2)
    if wrong := [part for part in parts if part.file_size > size]:
        raise ValueError(f"{path} has {size} bytes, and {brief(wrong[0].filename, 100)} in it announces "
                         f"{wrong[0].file_size}: it is damaged")  # fmt: skip
