"""Whether the codes of calibration frames fit the bits and the filters that are stated for them.

A camera's converter gives every whole number up to the largest one. Programs that store 12 bits in 16 often shift them
to the top, or stretch them: each code then stands for 16, and a camera with 12 bits would be full at a sixteenth.
"""

import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sensor_model.characterisation import Stack
from simscenes.sets.pictures.mosaic import is_mosaic, is_shifted

MOST = 2  # frames of each stack that are looked at
UNEVEN = 0.005  # of the range: what odd and even columns of a camera may differ by
ROUNDED = 0.98  # of a frame in two codes: noise of .24 DN and less, which EMVA 1288 calls too small to measure
ENOUGH = 32  # different codes: a light of fewer electrons than codes to an electron may leave gaps


def check_codes(stacks: Mapping[str, Stack], cfa: str, bits: int, folder: Path) -> None:
    """Refuse frames whose codes are of another scale than their bits, or of a mosaic that is not stated.

    Args:
        stacks: By name.
        cfa: "none" for a monochrome sensor.
        bits: Of the converter.
        folder: For messages.

    Raises:
        ValueError: If codes are below 0 or above the largest, have gaps between all of them, or flat frames have a
            pattern of 2 x 2.
    """
    kinds = {name: np.unique(stack.frames[:MOST]) for name, stack in stacks.items()}
    codes = np.unique(np.concatenate(list(kinds.values()))).astype(np.int64)
    low, high = min(kinds, key=lambda name: kinds[name][0]), max(kinds, key=lambda name: kinds[name][-1])
    if codes[0] < 0:
        raise ValueError(f"codes of {folder / low} must be >= 0, got {codes[0]}: a dark frame is probably subtracted; "
                         "give the frames as the sensor read them out")  # fmt: skip
    gaps = np.diff(codes)
    step = int(gaps.min()) if len(codes) >= ENOUGH else 1
    shifted = (step & -step) if step > 1 and not (codes % (step & -step)).any() else 1
    if shifted > 1:
        cause = (f"all of them are multiples of {shifted}: they are probably shifted to the top by "
                 f"{shifted.bit_length() - 1} bits; divide them by {shifted}")  # fmt: skip
    elif step > 1:
        cause = (f"none are closer together than {step}: they are probably stretched from fewer bits; save them as the "
                 "converter gave them")  # fmt: skip
    else:
        cause = "the bits are probably those of another mode, or frames were added up; give the bits of the codes"
    if codes[-1] >= 2**bits:
        raise ValueError(f"codes of {folder / high} must be at most {2**bits - 1} by the {bits} bits of its files or "
                         f"of frames.toml, got {codes[-1]}; {cause}")  # fmt: skip
    if step > 1:
        raise ValueError(f"codes of {folder} must be whole numbers without gaps by the {bits} bits of its files or of "
                         f"frames.toml, got {len(codes)} different ones up to {codes[-1]}; {cause}, and give the bits "
                         "that are left")  # fmt: skip
    for name, stack in stacks.items():
        if (held := 8 * stack.frames.dtype.itemsize) < bits:
            raise ValueError(f"frames of {folder / name} hold {held} bits, and {bits} are stated: the lowest were "
                             f"probably cut off; give the frames with all of them, or bits = {held}")  # fmt: skip
        if name.startswith("flat/") and (first := first_copy(stack.frames)) is not None:
            raise ValueError(f"frames {first[0] + 1} and {first[1] + 1} of {folder / name} are the same, and light "
                             "never is: remove the copies, which would count as frames without noise")  # fmt: skip
    darkest = max(_in_two_codes(stack.frames[0]) for name, stack in stacks.items() if name.startswith("dark/"))
    if darkest > ROUNDED:
        warnings.warn(f"{darkest:.1%} of a dark frame of {folder} are of two codes: its noise is below a code, so that "
                      "read noise and DSNU are those of rounding, and the gain is off by some per cent; give frames "
                      "with more bits, or of a higher gain", stacklevel=3)  # fmt: skip
    if cfa == "none":
        _refuse_mosaic(stacks, folder)
    else:
        _refuse_shifted(stacks, cfa, bits, folder)


def _in_two_codes(frame: np.ndarray) -> float:
    """The share of pixels that have one of the two commonest codes."""
    return float(np.sort(np.unique(frame, return_counts=True)[1])[-2:].sum() / frame.size)


def first_copy(frames: np.ndarray) -> tuple[int, int] | None:
    """The first two frames of the same codes, which are not all one code, as where light is beyond saturation."""
    known: dict[bytes, int] = {}
    for i, frame in enumerate(frames):
        if (first := known.setdefault(hashlib.sha256(frame.tobytes()).digest(), i)) != i and np.ptp(frame):
            return first, i
    return None


def _refuse_shifted(stacks: Mapping[str, Stack], cfa: str, bits: int, folder: Path) -> None:
    black = float(np.median([np.median(stack.frames[0]) for name, stack in stacks.items() if name.startswith("dark/")]))
    for name, stack in stacks.items():
        if name.startswith("flat/") and is_shifted(stack.frames[:MOST].mean(0) - black, cfa, UNEVEN * 2**bits):
            raise ValueError(f"frames of {folder / name} count as behind the filters {cfa}, and its two places of "
                             "green differ, while red and blue are the same: they lie a row or a column beside; give "
                             "the right cfa in frames.toml")  # fmt: skip


def _refuse_mosaic(stacks: Mapping[str, Stack], folder: Path) -> None:
    for name, stack in stacks.items():
        if name.startswith("flat/") and is_mosaic(stack.frames[:MOST].mean(0), flat=True):
            raise ValueError(f"frames of {folder / name} count as monochrome, and have a pattern of 2 x 2 over the "
                             "whole picture: they are probably behind a camera's colour filters; give cfa = \"RGGB\" "
                             "(or GRBG, GBRG, BGGR) in frames.toml")  # fmt: skip
