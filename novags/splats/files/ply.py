"""Gaussians to and from the standard 3DGS PLY layout: binary little-endian, one vertex per Gaussian.

Properties: x y z nx ny nz f_dc_0..2 f_rest_0..(3(K-1)-1) opacity (logit) scale_0..2 (log) rot_0..3 (wxyz).
f_rest is channel-major: all red coefficients, then green, then blue.
"""

from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch

from sensor_model.files.atomic import atomic
from sensor_model.files.door import opened
from sensor_model.files.reading import PLY_TYPES, brief

from ..gaussians import Gaussians
from ..raster.raster_torch import unit_largest
from ..raster.validation import check_gaussians
from ..sh import n_coefficients

HEADER_LINES = 1000  # of them 3DGS needs about 70
OPAQUE = 16.0  # logit of an opacity that is 1 but for 1e-7; an infinite one has no gradient
LEAST = {"format": 3, "element": 3, "property": 3}  # words of a line


def _names(k: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(3 * (k - 1))]
    return [*names, "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def write_ply(path: str | Path, gaussians: Gaussians, *, sh_degree: int | None = None) -> None:
    """Write Gaussians as a 3DGS PLY that common viewers open; atomic (temporary name, then rename).

    Args:
        path: File to write; its folder is created.
        gaussians: Any size; quaternions are written normalised.
        sh_degree: Pad the harmonics to this degree with zeros: some readers take nothing but 3. None: no padding.

    Raises:
        ValueError: If the Gaussians have a higher degree than that, or a quaternion is zero.
    """
    g = gaussians.detach()
    n, k = len(g), n_coefficients(g.sh_degree if sh_degree is None else sh_degree)
    if k < g.sh.shape[1]:
        raise ValueError(f"sh_degree must be at least {g.sh_degree}, the Gaussians' degree, got {sh_degree}")
    sh = torch.cat([g.sh, g.sh.new_zeros(n, k - g.sh.shape[1], 3)], 1)
    rest = sh[:, 1:].mT.reshape(n, 3 * (k - 1))
    columns = [g.means, torch.zeros(n, 3), g.sh[:, 0], rest, g.logit_opacities[:, None], g.log_scales, unit_quats(g)]
    table = torch.cat([column.cpu().float() for column in columns], dim=1).numpy().astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {name}" for name in _names(k)] + ["end_header"]
    with atomic(path) as temporary, temporary.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode("ascii"))
        file.write(table.tobytes())


def unit_quats(gaussians: Gaussians) -> torch.Tensor:
    """Rotations wxyz of length 1 [N, 4]; raises ValueError for a quaternion that is zero or not finite."""
    check_gaussians({"quats": gaussians.quats})
    return torch.nn.functional.normalize(unit_largest(gaussians.quats), dim=-1)


def _read_header(file: BinaryIO, path: Path) -> tuple[str, int, np.dtype, bool]:
    """Format, number and record type of vertices, and whether they end the file; leaves `file` at the first of them."""
    kind, n, fields, element = "", -1, dict[str, str](), ""
    for _ in range(HEADER_LINES):
        line = file.readline(4096).decode("ascii", "replace")
        words = line.split()
        if not line:
            break
        if words[:1] == ["end_header"]:
            return kind, n, np.dtype(list(fields.items())), element == "vertex"
        if len(words) < LEAST.get(words[0] if words else "", 0):
            raise ValueError(f"{path}: a line of the PLY header is not complete: {brief(repr(line.strip()))}")
        if words[:1] == ["format"]:
            kind = words[1]
        elif words[:1] == ["element"]:
            if not element and words[1] != "vertex":
                raise ValueError(f"{path}: the first PLY element must be vertex, got {brief(words[1])}")
            element = words[1]
            n = _count(words[2], path) if element == "vertex" else n
        elif words[:1] == ["property"] and element == "vertex":
            if words[1] not in PLY_TYPES or words[-1] in fields:
                raise ValueError(
                    f"{path}: vertex properties must be plain numbers, each once, got {brief(' '.join(words))}"
                )
            fields[words[-1]] = f"<{PLY_TYPES[words[1]]}"
    raise ValueError(f"{path} must be a PLY file with an end_header line, but its header ends early")


def _count(word: str, path: Path) -> int:
    if not (word.isascii() and word.isdigit() and len(word) <= 15):
        raise ValueError(f"{path}: the number of vertices must be a whole number, got {word[:40]!r}")
    return int(word)


def read_ply(path: str | Path) -> Gaussians:
    """Read a 3DGS PLY, binary little-endian; extra properties are ignored, any order is accepted.

    Converters of 8-bit formats write infinite logits of opacity, for 0 and 1. They become -`OPAQUE` and `OPAQUE`.

    Raises:
        ValueError: If the file is not such a PLY, is cut short or longer than its header says, lacks a property, or
            holds a number that is not finite or a rotation that is 0.
    """
    path = Path(path)
    with opened(path) as file:
        if file.readline(16).strip() != b"ply":
            raise ValueError(f"{path} must start with the line 'ply'")
        kind, n, record, is_last = _read_header(file, path)
        if kind != "binary_little_endian":
            raise ValueError(f"{path} must be binary_little_endian, got {kind or 'no format line'}; convert it first")
        there = path.stat().st_size - file.tell()
        if n < 0 or there < n * record.itemsize:  # before anything is allocated for the announced size
            raise ValueError(
                f"{path} must hold {n} vertices of {record.itemsize} bytes, but only {there} bytes are there"
            )
        if is_last and there > n * record.itemsize:
            raise ValueError(
                f"{path} must end after {n} vertices of {record.itemsize} bytes, as its header says, but {there} bytes "
                "are there: write it again"
            )
        data = file.read(n * record.itemsize)
    table = np.frombuffer(data, record, count=n)
    n_rest = sum(name.startswith("f_rest_") for name in record.names or ())
    degree = {3 * (n_coefficients(d) - 1): d for d in range(4)}.get(n_rest)
    if degree is None:
        raise ValueError(f"{path} must have 0, 9, 24 or 45 f_rest properties, got {n_rest}")
    k = n_coefficients(degree)
    missing = [name for name in _names(k) if name not in (record.names or ()) and name not in ("nx", "ny", "nz")]
    if missing:
        raise ValueError(f"{path} lacks the vertex properties {', '.join(missing)}: not a 3DGS PLY")

    def columns(*names: str, infinite: float = np.inf) -> torch.Tensor:
        with np.errstate(over="ignore"):  # a double beyond float32 becomes inf
            values = np.stack([table[name].astype(np.float32) for name in names], axis=-1)
        values = np.where(np.isinf(values), np.copysign(np.float32(infinite), values), values)
        if not np.isfinite(values).all():
            first = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise ValueError(f"{path} must hold finite numbers in {', '.join(names)}, got {values[first]} at {first}")
        return torch.from_numpy(values)

    quats = columns("rot_0", "rot_1", "rot_2", "rot_3")
    zero = torch.nonzero((quats == 0).all(1))[:, 0].tolist()
    if zero:
        raise ValueError(
            f"{path} must hold rotations rot_0..3 of non-zero length, got [0, 0, 0, 0] at {zero[0]} "
            f"({len(zero)} of {n}): write it again"
        )
    sh = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    if k > 1:
        rest = columns(*(f"f_rest_{i}" for i in range(n_rest))).reshape(n, 3, k - 1).mT
        sh = torch.cat([sh, rest], dim=1)
    return Gaussians(
        means=columns("x", "y", "z"),
        quats=quats,
        log_scales=columns("scale_0", "scale_1", "scale_2"),
        logit_opacities=columns("opacity", infinite=OPAQUE)[:, 0],
        sh=sh.contiguous(),
    )
