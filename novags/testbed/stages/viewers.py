"""A run's Gaussians and cameras as the viewers of others open them, in a folder of the run."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from novags.splats.files.compact import write_splat, write_spz
from novags.splats.files.ply import read_ply, write_ply
from novags.testbed.folders.run import CAMERAS, RECORD, SCENE, VIEWERS
from novags.testbed.ledger.contents import read_json
from sensor_model.files.atomic import atomic
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief

FILES = {"3dgs": (SCENE, CAMERAS), "splat": ("scene.splat",), "spz": ("scene.spz",), "spz2": ("scene-v2.spz",)}
FORMATS = tuple(FILES)


def check_formats(formats: Sequence[str]) -> None:
    """Raise ValueError for a format that does not exist."""
    if unknown := [name for name in formats if name not in FORMATS]:
        raise ValueError(f"export must be among {', '.join(FORMATS)}; got {brief(', '.join(unknown))}")


def check_viewers(folder: Path, formats: Sequence[str]) -> None:
    """Raise ValueError for a format that does not exist, or where a finished run holds no Gaussians to write."""
    check_formats(formats)
    if formats and not (folder / SCENE).is_file():
        raise ValueError(f"{folder} has no {SCENE}: only Gaussians can be exported as {', '.join(formats)}")


def viewer_files(folder: Path, formats: Sequence[str]) -> list[Path]:
    """What `write_viewers` writes."""
    return [folder / VIEWERS / file for name in formats for file in FILES[name]]


def write_viewers(folder: Path, formats: Sequence[str]) -> str:
    """Write the Gaussians of a finished run for the viewers of others.

    Args:
        folder: Of the run.
        formats: "3dgs" (.ply of degree 3, with cameras.json), "splat", "spz", "spz2" (for readers of version 2 alone).

    Returns:
        Why viewers show other colours than the pictures of the run, for the user; "" where they show these.

    Raises:
        ValueError: If the method has not made Gaussians, or a format cannot hold them.
    """
    check_viewers(folder, formats)
    if not formats:
        return ""
    record = read_json(folder / RECORD)
    gaussians, out = read_ply(folder / SCENE), folder / VIEWERS
    if "3dgs" in formats:
        write_ply(out / SCENE, gaussians, sh_degree=3)
        if (folder / CAMERAS).is_file():  # runs made before there was one have none
            with atomic(out / CAMERAS) as temporary:
                shutil.copyfile(admitted(folder / CAMERAS), temporary)
    if "splat" in formats:
        write_splat(out / "scene.splat", gaussians)
    for name, file, version in (("spz", "scene.spz", 3), ("spz2", "scene-v2.spz", 2)):
        if name in formats:
            write_spz(out / file, gaussians, version=version, antialiased=bool(record.get("antialiased")))
    light = record.get("response") is not None or (record.get("space") == "linear" and record.get("tone") is None)
    return "" if not light else (
        f"the Gaussians of {folder} hold light, which viewers of others take for sRGB code: they look darker there "
        "than in the pictures of the run, which novags view shows"
    )  # fmt: skip
