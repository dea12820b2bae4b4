"""Dark photographs to import, their lit and clean twins, and the capture that comes of them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.case import Reader
from tests.fuzz.readers.text import pictures, some_rig

NAMES, SIZE = ["a", "b"], (24, 32)


def make_photographs(folder: Path) -> None:
    """dark/: 8-bit pictures with raw/ beside them; sixteen/: 16-bit TIFF; lit/ and long/."""
    import cv2

    from sensor_model import PRESETS, Exposure, write_dng
    from simscenes.sets.writers.camera_files import write_cameras

    rng, rig = np.random.default_rng(0), some_rig(2, SIZE[1], SIZE[0])
    for part in ("dark", "sixteen"):
        write_cameras(folder / part, NAMES, rig)
        for file in ("nb-info.json", "train_list.txt", "val_list.txt", "test_list.txt"):
            (folder / part / file).unlink()
        shutil.rmtree(folder / part / "sparse")
    for part in ("dark/images", "lit"):
        pictures(folder / part, NAMES, SIZE[1], SIZE[0])
    (folder / "sixteen" / "images").mkdir()
    for name in NAMES:
        for part, high in (("dark/raw", 900), ("long", 3500)):
            dn = rng.integers(240, high, SIZE, np.uint16)
            write_dng(folder / part / f"{name}.dng", dn, PRESETS["imx900-hcg"], Exposure(time=0.02))
        codes = rng.integers(0, 65535, (*SIZE, 3), np.uint16)
        cv2.imwrite(str(folder / "sixteen" / "images" / f"{name}.tif"), codes)
    listing = folder / "sixteen" / "transforms.json"
    listing.write_text(listing.read_text().replace(".png", ".tif"))


def import_whole(folder: Path, file: Path) -> object:
    """By the command's own stage, whatever was damaged."""
    from novags.testbed.console.terminal import Console
    from novags.testbed.stages.configs.importing import ImportConfig
    from novags.testbed.stages.importing import import_photographs

    part = "sixteen" if file.is_relative_to(folder / "sixteen") else "dark"
    twins: dict[str, Any] = {} if part == "sixteen" else {"lit": folder / "lit", "clean": folder / "long"}
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    try:
        config = ImportConfig(demosaic="bilinear", **twins)
        import_photographs(folder / part, out, config, Console(quiet=True))
        return {path.name: path.read_bytes() for path in out.rglob("*.[pe][nx][gr]")}
    finally:
        shutil.rmtree(out, ignore_errors=True)


def make_imported(folder: Path) -> None:
    from novags.testbed.console.terminal import Console
    from novags.testbed.stages.configs.importing import ImportConfig
    from novags.testbed.stages.importing import import_photographs

    make_photographs(folder / "from")
    twins = {"lit": folder / "from" / "lit", "clean": folder / "from" / "long"}
    config = ImportConfig(sensor="imx900-hcg", demosaic="bilinear", **twins)
    import_photographs(folder / "from" / "dark", folder / "cap", config, Console(quiet=True))


def read_imported(folder: Path, file: Path) -> object:
    """As reconstruct and score do."""
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.capture import open_capture

    capture = open_capture(folder / "cap")
    source = capture.source(Console(quiet=True))
    parts = [part(0) for part in (capture.srgb8, capture.linear, capture.clean, capture.raw, source.lit)]
    return parts, capture.levels, capture.noise, capture.channels_share, source.digest(), source.points()


def _stage() -> None:
    import cv2
    import PIL.Image  # noqa: F401
    import pycolmap  # noqa: F401
    import rawpy  # noqa: F401

    import novags.testbed.stages.importing  # noqa: F401

    cv2.setNumThreads(0)


FILES = ("dark/*", "sixteen/*", "lit/*", "long/*")
READERS = [
    Reader("photographs to import", make_photographs, import_whole, FILES, share=0.5, prepare=_stage),
    Reader("an imported capture", make_imported, read_imported, ("cap/capture.json", "cap/truth/*", "cap/lit/*"),
           share=0.7, prepare=_stage),
]  # fmt: skip
