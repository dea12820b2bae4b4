"""Whether pixels on disk are those asked for: hashes of everything they depend on, and files that carry them."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from sensor_model.files.records import read_record
from sensor_model.plan import Plan
from simscenes.rigs import Rig
from simscenes.sets.pictures.exr import read_exr

VIEW_KEY = "novagsKey"
LEAST = "leastSpp"  # beside it, where other views of the set decided how many samples the view has at least
CLAIMS = ("seconds", "tolerance", "rms")  # parts of a plan that only state how accurate and how costly it is
SPENT = "seconds.json"  # cost of an unfinished job so far; not in the EXRs, whose bytes must not depend on the clock


def plan_identity(plan: str | Plan) -> Any:
    """The part of a plan that the pixels may depend on: not how long its pilots took, nor how wrong it may be."""
    if not isinstance(plan, Plan):
        return plan
    told = {key: value for key, value in plan.to_dict().items() if key not in CLAIMS}
    if not told.get("hide_emitters"):
        told.pop("hide_emitters", None)  # as in plans made before this option existed
    return without_nan(told)


def without_nan(value: Any) -> Any:
    """JSON has no nan and no inf: a number that was not measured becomes null."""
    if isinstance(value, dict):
        return {k: without_nan(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def job_digest(config: dict[str, Any], rig: Rig) -> str:
    """Hash of a configuration and the cameras, 64 hex digits."""
    text = json.dumps([config, rig.width, rig.height], sort_keys=True).encode()
    return hashlib.sha256(text + rig.viewmats.tobytes() + rig.Ks.tobytes()).hexdigest()


def view_key(config: dict[str, Any], rig: Rig, i: int) -> str:
    """Identity of one view's pixels; with motion the neighbouring cameras matter too."""
    chosen = slice(None) if config["optics"]["motion"] is not None else slice(i, i + 1)
    view = Rig(viewmats=rig.viewmats[chosen], Ks=rig.Ks[chosen], width=rig.width, height=rig.height)
    return job_digest(config, view) + (f":{i}" if config["optics"]["motion"] is not None else "")


def is_complete(out: Path, digest: str, names: list[str]) -> bool:
    """Whether a folder holds the finished set of that digest, with all its files."""
    try:
        same = read_record(out / "set.json").get("digest") == digest
    except ValueError:
        return False  # no set.json, or a damaged one: the set is rendered and written again
    files = [out / "gt" / f"{n}.exr" for n in names] + [out / "images" / f"{n}.png" for n in names]
    return same and all(f.is_file() for f in files)


def seconds_spent(out: Path, digest: str) -> dict[str, float]:
    """Seconds per stage that the same job took before it was interrupted."""
    try:
        spent = read_record(out / SPENT)
        return dict(spent["seconds"]) if spent["digest"] == digest else {}
    except (ValueError, KeyError, TypeError):
        return {}  # not interrupted, or in the middle of writing this; it only adds to a sum


def finished_view(path: Path, key: Callable[[int], str]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Channels and header of a view that was rendered before with the same settings, else None.

    `key` gives the view's identity for the samples that it had to have at least.
    """
    if not path.is_file():
        return None
    try:
        channels, header = read_exr(path)
    except ValueError:
        return None  # cut short by a crash of the machine: rendered again
    return (channels, header) if header.get(VIEW_KEY) == key(int(header.get(LEAST, 0))) else None
