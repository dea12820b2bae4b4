"""The dark and flat frames of a camera, from a folder.

FOLDER/dark/NAME/*   each NAME is one stack: two or more dark frames, all of one exposure time
FOLDER/flat/NAME/*   the same in front of a uniform light
FOLDER/frames.toml   optional: values that the files themselves do not state
FOLDER/isoN/         or such folders at several ISOs, which may share FOLDER/frames.toml

Frames are camera raw files, 16-bit PNG or TIFF of one channel (of any number of pages), or .npy of [h,w] or [n,h,w].
Exposure times come from
frames.toml, else from EXIF. Every line of frames.toml is optional, except `bits` if no raw file states it:

bits = 12                    # of the ADC
cfa = "RGGB"                 # colour filter array; raw files state it, other files count as monochrome
[camera]                     # values that frames cannot show, or better ones: fields of a camera file
eta = 0.6
[stacks."flat/middle"]
time = 0.01                  # s
photons = 812.0              # mean number per pixel, if it was measured: gives the quantum efficiency

sensor_model sees the frames only as arrays; only this module knows the layout of the folder.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.folders.photographs.raw_files import is_raw, read_mosaic
from novags.testbed.importing.calibration.codes import check_codes
from novags.testbed.importing.exposures import OF_FRAMES, check_iso, stated_of
from novags.testbed.importing.stored import is_lossy
from sensor_model.characterisation import Stack
from sensor_model.files.door import opened
from sensor_model.files.reading import reading, some
from sensor_model.files.records import check_shape
from sensor_model.files.toml_file import read_toml
from sensor_model.frame.measured import middle
from sensor_model.mosaicking import channel_index
from simscenes.sets.pictures.image_file import read_frames as read_frames_of

IMAGES = (".png", ".tif", ".tiff")
# Notes and previews beside frames; files of other kinds may be frames.
BESIDE = ("", ".txt", ".md", ".csv", ".json", ".toml", ".xml", ".yaml", ".yml", ".ini", ".log", ".xmp", ".pp3", ".jpg",
          ".jpeg", ".db", ".pdf", ".html")  # fmt: skip
ISO_NAME = re.compile(r"iso[ _-]?([1-9]\d{0,8})", re.IGNORECASE)
CHANNELS = 4  # most samples of a pixel
NOTES = {"bits?": int, "cfa?": str, "camera?": dict, "stacks?": {"*": {"time?": float, "photons?": float}}}


@dataclass(frozen=True)
class Frames:
    """Everything a folder holds."""

    dark: list[Stack]
    flat: list[Stack]  # may be empty
    iso: float | None  # by the folder's name and by the files
    cfa: str  # "none": monochrome
    bits: int
    camera: dict[str, Any]  # fields that override measured ones


@dataclass(frozen=True)
class CalibrationFrame:
    """The codes of one file, and what it states of them."""

    dn: np.ndarray  # [n,h,w]
    time: float | None = None
    cfa: str | None = None
    bits: int | None = None


def read_frames(folder: Path, window: int = 1024, notes_of: Path | None = None) -> Frames:
    """Read the folder; every frame is cropped to the central `window` x `window` pixels.

    Args:
        folder: With dark/ and flat/.
        window: In pixels.
        notes_of: The folder of frames.toml; None: the same.

    Raises:
        ValueError: If it is not laid out as above, or a file cannot be read.
    """
    notes = _notes(notes_of or folder)
    files: dict[str, list[CalibrationFrame]] = {}
    for kind in ("dark", "flat"):
        for place in stacks_in(folder, kind):
            files[f"{kind}/{place.name}"] = [cut(read_frame(p), (window, window)) for p in listed(place)]
    if unknown := sorted(set(notes["stacks"]) - set(files)):
        raise ValueError(
            f"{(notes_of or folder) / 'frames.toml'} names stacks that are not there: {', '.join(unknown)}"
        )
    everything = [file for stack in files.values() for file in stack]
    _refuse_untold(folder, files, notes)
    stacks = {name: _stack(folder / name, stack, notes["stacks"].get(name, {})) for name, stack in files.items()}
    named = ISO_NAME.fullmatch(folder.name)
    paths = [path for name in files for path in listed(folder / name)]
    frames = Frames(
        dark=[stack for name, stack in stacks.items() if name.startswith("dark/")],
        flat=[stack for name, stack in stacks.items() if name.startswith("flat/")],
        iso=check_iso(paths, OF_FRAMES, float(named[1]) if named else None, "the name of the folder"),
        cfa=agreed("cfa", notes["cfa"], [f.cfa for f in everything], folder, "none"),
        bits=agreed("bits", notes["bits"], [f.bits for f in everything], folder, None),
        camera=notes["camera"],
    )
    check_codes(stacks, frames.cfa, frames.bits, folder)
    return frames


def _refuse_untold(folder: Path, files: dict[str, list[CalibrationFrame]], notes: dict[str, Any]) -> None:
    """Refuse frames whose exposure times or bits neither the files nor frames.toml state, and name all of them."""
    timed = {name for name, stack in files.items() if any(file.time is not None for file in stack)}
    told = {name for name, note in notes["stacks"].items() if "time" in note}
    lines = [f'[stacks."{name}"] and below it time = SECONDS' for name in files if name not in timed | told]
    missing = ["exposure times"] if lines else []
    if notes["bits"] is None and not any(file.bits is not None for stack in files.values() for file in stack):
        missing, lines = ["bits", *missing], ["bits = N", *lines]
    if lines:
        raise ValueError(f"the files in {folder} do not state their {' and '.join(missing)}: give in frames.toml "
                         f"{'; '.join(lines)}")  # fmt: skip


def stacks_in(folder: Path, kind: str) -> list[Path]:
    """The folders of stacks, "dark" or "flat"; of the latter there may be none.

    Raises:
        ValueError: If there are none in the dark.
    """
    place = folder / kind
    folders = sorted(p for p in place.iterdir() if p.is_dir()) if place.is_dir() else []
    if not folders and (kind == "dark" or place.is_dir()):
        raise ValueError(f"{folder} needs a folder {kind}/ with a folder for each stack of frames in it")
    return folders


def iso_folders(folder: Path) -> dict[float, Path]:
    """The folders of single ISOs in a folder, by rising ISO: iso800, ISO_1600."""
    found = [(match, path) for path in folder.iterdir() if path.is_dir() and (match := ISO_NAME.fullmatch(path.name))]
    return dict(sorted((float(match[1]), path) for match, path in found))


def listed(place: Path) -> list[Path]:
    """The frames of a folder, without hidden files, which archives made on a Mac have.

    Raises:
        ValueError: If there are none, or files beside them that may be frames and are not read.
    """
    shown = sorted(place.glob("[!.]*"))
    found = [p for p in shown if is_raw(p) or p.suffix.lower() in (*IMAGES, ".npy")]
    left = [p.name for p in shown if p not in found and p.suffix.lower() not in BESIDE]
    if not found or left:
        there = f"files of other kinds ({some(left, 4)})" if left else "no frames"
        raise ValueError(f"{place} must hold frames as camera raw files, {', '.join(IMAGES)} or .npy, got {there}: "
                         "convert them to 16-bit TIFF or to one .npy of [n,h,w], or move them away")  # fmt: skip
    return found


def _notes(folder: Path) -> dict[str, Any]:
    path = folder / "frames.toml"
    notes: dict[str, Any] = {"bits": None, "cfa": None, "camera": {}, "stacks": {}}
    given = read_toml(path) if path.exists() else {}
    if unknown := sorted(set(given) - set(notes)):
        raise ValueError(f"{path}: unknown {', '.join(unknown)}; available: {', '.join(notes)}")
    check_shape(given, NOTES, f"{path}")
    return notes | given


def read_frame(path: Path) -> CalibrationFrame:
    """The codes of a file, and what it states of them.

    Raises:
        ValueError: If it cannot be read, or does not hold the codes of one channel.
    """
    if is_raw(path):
        raw = read_mosaic(path)
        return CalibrationFrame(raw.dn[None], raw.time, raw.cfa or "none", raw.bits)
    time = None
    if path.suffix.lower() == ".npy":
        with reading(path, "replace or remove it"):
            with opened(path) as file:
                dn = np.load(file, allow_pickle=False)
        dn = dn[None] if dn.ndim == 2 else dn
    else:
        if is_lossy(path):
            raise ValueError(f"{path} must be stored without loss, got JPEG in a TIFF: its noise is not the camera's; "
                             "save frames uncompressed")  # fmt: skip
        dn, time = read_frames_of(path), stated_of(path)[0]
    if dn.ndim == 4 and all((dn[..., k] == dn[..., 0]).all() for k in range(1, dn.shape[3])):
        dn = dn[..., 0]  # programs of monochrome cameras write three equal samples
    if dn.ndim != 3 or dn.dtype.kind not in "ui":
        colours = dn.ndim == 4 and dn.dtype.kind in "ui"
        why = ": colours are developed already; save the mosaic as the sensor read it out" if colours else ""
        raise ValueError(f"{path} must hold integer codes of one channel, got {dn.dtype} of shape {dn.shape}{why}")
    if dn.shape[2] <= CHANNELS < dn.shape[1]:
        raise ValueError(f"{path} must hold frames as [n,h,w], got the shape {dn.shape}, whose last side may be "
                         "channels: save one channel, with frames first")  # fmt: skip
    return CalibrationFrame(dn, time)


def cut(file: CalibrationFrame, size: tuple[int, int]) -> CalibrationFrame:
    """The central part, from an even row and column on, so that the colour filter array keeps its phase."""
    return replace(file, dn=np.ascontiguousarray(middle(file.dn, size)))


def _stack(path: Path, files: list[CalibrationFrame], note: dict[str, float]) -> Stack:
    sizes = {file.dn.shape[1:] for file in files}
    if len(sizes) != 1:
        raise ValueError(f"{path} must hold frames of one size, got {sorted(sizes) or 'no frames'}")
    if unknown := sorted(set(note) - {"time", "photons"}):
        raise ValueError(f"frames.toml: stack {path.name} has unknown {', '.join(unknown)}; available: time, photons")
    time = agreed("exposure time", note.get("time"), [f.time for f in files], path, None)
    return Stack(np.concatenate([f.dn for f in files]), float(time), note.get("photons"))


def agreed(what: str, given: Any, found: list[Any], where: Path, default: Any) -> Any:
    """The value in frames.toml, else the value that all files state, else the default."""
    told = {value for value in found if value is not None}
    if given is None and len(told) > 1:
        raise ValueError(f"the files in {where} differ in {what}: {', '.join(map(str, sorted(told)))}")
    return given if given is not None else next(iter(told), default)


def plane(stacks: list[Stack], place: int) -> list[Stack]:
    """One of the four kinds of pixels of a mosaic."""
    return [replace(s, frames=s.frames[:, place // 2 :: 2, place % 2 :: 2]) for s in stacks]


def colours(frames: Frames) -> dict[str, Any]:
    """Relative response of the filters to the flat light, and the error of each colour's black level."""
    kinds = channel_index((2, 2), frames.cfa).ravel()  # type: ignore[arg-type]  # there is a filter array here
    black, bright = (np.array([[s.frames.mean() for s in plane(stacks, i)] for i in range(4)])
                     for stacks in (frames.dark, frames.flat))  # fmt: skip
    rise, level = np.polyfit([s.time for s in frames.dark], black.T, 1)
    signal = bright - level[:, None] - rise[:, None] * [s.time for s in frames.flat]
    signal = signal[:, signal.max(0) < 0.7 * signal.max()].sum(1)  # none of the colours is near saturation there
    response, bias = (np.array([values[kinds == c].mean() for c in range(3)]) for values in (signal, level))
    return {
        "rgb_response": (response / response[1]).tolist(),
        "rgb_bias": (bias - bias[1]).tolist(),
    }
