"""EXR, PNG of every kind, JPEG and DNG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader


def make_exr(folder: Path) -> None:
    from simscenes.sets.pictures.exr import write_exr

    rng = np.random.default_rng(0)
    planes = {c: rng.random((9, 11), np.float32) for c in ("R", "G", "B", "Z")}
    write_exr(
        folder / "a.exr", {**planes, "id": np.ones((9, 11), np.uint32)}, {"worldToCamera": np.eye(4, dtype=np.float32)}
    )
    import OpenEXR

    for kind in ("ZIPS", "PIZ", "RLE", "NO", "B44", "DWAA", "PXR24"):
        head = {"compression": getattr(OpenEXR, f"{kind}_COMPRESSION"), "type": OpenEXR.scanlineimage}
        half = {c: rng.random((9, 11)).astype(np.float16) for c in "RGB"}
        with OpenEXR.File(head, half) as file:
            file.write(str(folder / f"{kind.lower()}.exr"))


def read_exr(folder: Path, file: Path) -> object:
    from novags.testbed.folders.photographs.linear import _size
    from simscenes.sets.pictures.exr import read_exr

    return _size(file), read_exr(file)


def make_png(folder: Path) -> None:
    import cv2
    from PIL import Image

    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (13, 17, 3), np.uint8)
    picture = Image.fromarray(rgb)
    picture.save(folder / "rgb8.png")
    picture.convert("L").save(folder / "grey8.png")
    picture.convert("RGBA").save(folder / "alpha.png")
    picture.convert("LA").save(folder / "grey-alpha.png")
    picture.quantize(16).save(folder / "palette.png")
    picture.quantize(8).save(folder / "palette-clear.png", transparency=3)
    picture.convert("1").save(folder / "bits.png")
    deep = rng.integers(0, 65535, (13, 17, 3), np.uint16)
    cv2.imwrite(str(folder / "rgb16.png"), deep)
    cv2.imwrite(str(folder / "grey16.png"), deep[..., 0])
    (folder / "interlaced.png").write_bytes(interlaced(rgb[..., 0]))


def interlaced(grey: np.ndarray) -> bytes:
    """An 8-bit grey PNG in Adam7 order, which none of our libraries writes."""
    import struct
    import zlib

    rows = b""
    for y, x, dy, dx in (
        (0, 0, 8, 8),
        (0, 4, 8, 8),
        (4, 0, 8, 4),
        (0, 2, 4, 4),
        (2, 0, 4, 2),
        (0, 1, 2, 2),
        (1, 0, 2, 1),
    ):
        part = grey[y::dy, x::dx]
        rows += b"".join(b"\0" + row.tobytes() for row in part) if part.shape[1] else b""
    head = struct.pack(">IIBBBBB", grey.shape[1], grey.shape[0], 8, 0, 0, 0, 1)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    body = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def make_jpeg(folder: Path) -> None:
    from PIL import Image

    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (19, 33, 3), np.uint8))
    picture.save(folder / "plain.jpg", quality=85)
    picture.save(folder / "progressive.jpg", progressive=True)
    picture.convert("L").save(folder / "grey.jpg")
    exif = Image.Exif()
    exif[274], exif[33434] = 6, 0.01
    picture.save(folder / "exif.jpeg", exif=exif)


def read_picture(folder: Path, file: Path) -> object:
    """By every way in which a picture is read: as codes, as a photograph, and its size alone."""
    from novags.testbed.importing.calibration.frames import read_frame
    from simscenes.rigs import Rig, intrinsics
    from simscenes.sets.multiview import MultiviewSet
    from simscenes.sets.pictures.png import read_codes
    from simscenes.sets.readers.photographs import image_size

    rig = Rig(viewmats=np.eye(4)[None], Ks=intrinsics(17, 13, 60)[None], width=17, height=13)
    one = MultiviewSet(path=folder, names=("a",), rig=rig, kind="photographs", meta={}, files=(file,))
    ways = [image_size, read_codes, lambda f: one.image(0)]
    if file.name == "grey16.png":
        ways.append(read_frame)
    return _try_all(ways, file)


def _try_all(ways: list[Callable[[Path], object]], file: Path) -> list[object]:
    """Every reader, even where an earlier one refuses the file; then the first refusal."""
    errors, found = [], []
    for way in ways:
        try:
            found.append(way(file))
        except (ValueError, OSError) as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return found


def make_dng(folder: Path) -> None:
    from sensor_model import PRESETS, Exposure, write_dng

    rng = np.random.default_rng(0)
    shape = (24, 34)
    write_dng(folder / "bayer.dng", rng.integers(0, 4095, shape, np.uint16), PRESETS["imx900-hcg"], Exposure(time=0.02))
    write_dng(folder / "mono.dng", rng.integers(0, 4095, shape, np.uint16), PRESETS["prime-95b"], Exposure(time=0.02))
    write_dng(
        folder / "three.dng",
        rng.integers(0, 4095, (*shape, 3), np.uint16),
        PRESETS["imx900-hcg-3chip"],
        Exposure(time=1),
    )


def read_dng(folder: Path, file: Path) -> object:
    from novags.testbed.folders.photographs import raw_files

    ways = [raw_files.size, raw_files.read_digital_numbers, raw_files.read_radiance]
    if not file.name.startswith("three"):
        ways.append(raw_files.read_mosaic)
    return _try_all(ways, file)


def _images() -> None:
    import cv2
    import PIL.Image  # noqa: F401

    import simscenes.sets.multiview  # noqa: F401

    cv2.setNumThreads(0)


def _exr() -> None:
    import OpenEXR  # noqa: F401

    import novags.testbed.folders.photographs.linear  # noqa: F401


def _raw() -> None:
    import rawpy  # noqa: F401

    import novags.testbed.folders.photographs.raw_files  # noqa: F401


READERS = [
    Reader("EXR", make_exr, read_exr, ("*.exr",), cut=("a.exr",), share=10, prepare=_exr),
    Reader("PNG", make_png, read_picture, ("*.png",), cut=("grey8.png", "interlaced.png"), share=9, prepare=_images),
    Reader("JPEG", make_jpeg, read_picture, ("*.jp*g",), cut=("plain.jpg",), share=8, prepare=_images),
    Reader("DNG", make_dng, read_dng, ("*.dng",), cut=("bayer.dng",), share=8, prepare=_raw),
]
