"""capture.json as a typed value: the settings that its pictures were taken with, and their source.

A capture is simulated, or photographs that were imported: it has one of these two parts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.folders import shapes
from novags.testbed.folders.place import place_text
from novags.testbed.ledger.contents import read_json
from sensor_model.files.camera_file import sensor_from_dict
from sensor_model.files.reading import reading
from sensor_model.frame.uneven import EVEN, Uneven
from sensor_model.isp import DEMOSAIC, Demosaic
from sensor_model.params import Cfa, Exposure, Sensor

PARTS = ("images16", "raw", "truth", "lit", "depth", "scan")  # parts that imported photographs may lack
LARGEST = 1e6  # in a colour matrix, whose entries are of order 1: far larger ones overflow the float32 of pictures


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Facts about simulated exposures.

    Attributes:
        set_path: Where the set was, relative to the capture.
        set_content: Hash of the set at the time.
        max_size: Of the pictures, px; None: the set's.
        background: Behind transparent pixels of photographs; None: there are none.
        electrons: Mean of green over the set, e-.
        mean_green: Radiance that gave them; None: of an earlier version.
        signal_quantiles_e: Of the charge that the sensor's channels collect, e-, by the share of pixels that see less.
        jpeg_quality: None: PNG.
        seed: As asked for.
        noise_seed: Of the noise itself.
        plan: As `Plan.to_dict`; None: every effect is simulated.
        measured: Whether maps or dark frames took the place of drawn numbers: it keeps their hashes alone.
    """

    set_path: str
    set_content: str
    max_size: int | None
    background: str | None
    electrons: float
    mean_green: float | None
    signal_quantiles_e: Mapping[str, float]
    jpeg_quality: int | None
    seed: int
    noise_seed: int
    plan: dict[str, Any] | None
    measured: bool = False


@dataclass(frozen=True, kw_only=True)
class Imported:
    """Facts about somebody else's photographs.

    Attributes:
        parts: The folders among `PARTS` that are there.
        levels: Of raw frames: colour filter array (None: three chips), DN without light, DN of saturation.
        depth: "8bit", "16bit" or "raw", as given.
        lit: The views in good light: "folder", "paired", "resampled".
        clean: The long exposures: "folder", "paired", "gain", "white_share".
        dataset: The published data set; None: none.
        split: Who chose the held-out views.
        lit_alone: Names of held-out views without a dark picture.
        unlit: Names of views without a well-lit picture, where others have one.
        unscanned: Names of views without a measured depth, where others have one.
    """

    parts: tuple[str, ...]
    levels: tuple[Cfa | None, float, float] | None
    depth: str
    lit: Mapping[str, Any] | None
    clean: Mapping[str, Any] | None
    dataset: str | None
    split: str | None
    lit_alone: tuple[str, ...] = ()
    unlit: tuple[str, ...] = ()
    unscanned: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class CaptureRecord:
    """The content of capture.json.

    Attributes:
        scene: Its name; None: of an earlier version.
        sensor_name: None: not known.
        sensor: None: not known.
        exposure: How the camera was used; common to all views.
        burst: Frames that each view is the mean of.
        uneven: How single views differ from it, in white balance too.
        demosaic: How mosaics became pictures.
        color_matrix: From the camera's colours to linear sRGB, [3,3]; None: identity.
        views: How many.
        width: Of the pictures, px.
        height: Of the pictures, px.
        jpeg: Whether some pictures were compressed with losses.
        resampled: How pixels were averaged after the exposure, in words that complete "of their pixels"; None: not.
        files: The photograph of each view, where they were renamed or imported.
        stage: The ledger's entry on its making: key, configuration, cost, checksums.
        simulated: Of simulated exposures.
        imported: Of photographs.
    """

    scene: str | None
    sensor_name: str | None
    sensor: Sensor | None
    exposure: Exposure
    burst: int
    uneven: Uneven
    demosaic: Demosaic
    color_matrix: list[list[float]] | None
    views: int
    width: int
    height: int
    jpeg: bool
    resampled: str | None
    files: Mapping[str, str]
    stage: Mapping[str, Any]
    simulated: Simulated | None
    imported: Imported | None

    @property
    def dataset(self) -> str | None:
        """The published data set that it is of; None: none."""
        return None if self.imported is None else self.imported.dataset

    @property
    def variety(self) -> str:
        """How views were taken, if not one exposure each and all alike; in words for a title."""
        times = self.uneven.exposures
        found = [f"bursts of {self.burst}"] if self.burst > 1 else []
        found += [f"exposed {min(times):.3g} to {max(times):.3g} times as long"] if set(times) - {1.0} else []
        even = set(self.uneven.balances) <= {(1.0, 1.0, 1.0)}
        return ", ".join([*found, *([] if even else ["white balance by view"])])


def read_capture_record(path: Path) -> CaptureRecord:
    """The capture.json at `path`.

    Raises:
        ValueError: If it has changed since the stage wrote it.
    """
    foreign = read_json(path).get("kind") == "imported"
    found = read_json(path, shapes.IMPORT if foreign else shapes.CAPTURE)
    imported = _imported(found, path) if foreign else None
    largest = np.abs(found["color_matrix"] or 0.0).max()
    if largest > LARGEST:
        raise ValueError(f"{path}: color_matrix must hold numbers up to {LARGEST:g}, got {largest:g}: capture again")
    with reading(path, "capture again"):
        uneven = EVEN if "uneven" not in found else _uneven(found["uneven"], found)
        sensor = None if found["sensor"] is None else sensor_from_dict(found["sensor"])
        exposure = Exposure(**{**found["exposure"], "origin": tuple(found["exposure"]["origin"])})
        if found["demosaic"] not in DEMOSAIC:
            raise ValueError(f"demosaic must be one of {', '.join(DEMOSAIC)}, got {found['demosaic']!r}")
    return CaptureRecord(
        scene=str(found["scene"]) if "scene" in found else None,
        sensor_name=found["sensor_name"],
        sensor=sensor,
        exposure=exposure,
        burst=found.get("burst", 1),
        uneven=uneven,
        demosaic=found["demosaic"],
        color_matrix=found["color_matrix"],
        views=found["views"],
        width=found["width"],
        height=found["height"],
        jpeg=found["jpeg"] if foreign else found.get("jpeg_quality") is not None,
        resampled=found.get("resampled"),
        files=found.get("files", {}),
        stage=found["stage"],
        simulated=None if foreign else _simulated(found),
        imported=imported,
    )


def _uneven(told: dict[str, Any], found: dict[str, Any]) -> Uneven:
    views, matrix = found["views"], found["color_matrix"]
    exposures, balances = told["exposures"], tuple(map(tuple, told["balances"]))
    if not len(exposures) == len(balances) == views:
        raise ValueError(f"uneven must say exposure and balance of each of {views} views, got {len(exposures)} and "
                         f"{len(balances)}")  # fmt: skip
    if not all(1 / LARGEST <= factor <= LARGEST for factor in chain(exposures, *balances)):
        raise ValueError(f"uneven must hold factors in {1 / LARGEST:g}..{LARGEST:g}")
    return Uneven(exposures=tuple(exposures), balances=balances, matrix=matrix and tuple(map(tuple, matrix)))


def _simulated(found: dict[str, Any]) -> Simulated:
    made_of, seed = found["set"], found.get("seed", 0)
    return Simulated(
        set_path=place_text(made_of["path"]), set_content=found["stage"]["inputs"]["set"], max_size=made_of["max_size"],
        background=made_of.get("background"), electrons=found["electrons"], mean_green=found.get("mean_green_radiance"),
        signal_quantiles_e=found["signal_quantiles_e"], jpeg_quality=found.get("jpeg_quality"), seed=seed,
        noise_seed=found.get("noise_seed", seed), plan=found["plan"],
        measured="maps" in found or "dark_frames" in found,
    )  # fmt: skip


def _imported(found: dict[str, Any], path: Path) -> Imported:
    raw = found["raw"]
    if unknown := [part for part in found["parts"] if part not in PARTS]:
        raise ValueError(f"{path}: parts must be among {', '.join(PARTS)}, got {unknown[0]!r}: import again")
    if ("raw" in found["parts"]) != (raw is not None):
        raise ValueError(f"{path}: raw frames and their levels must both be there or neither: import again")
    return Imported(
        parts=tuple(found["parts"]), levels=raw and (raw["cfa"], float(raw["black"]), float(raw["white"])),
        depth=found["depth"], lit=found["lit"], clean=found["clean"], dataset=found.get("dataset"),
        split=found.get("split"), **{key: tuple(found.get(key, ())) for key in ("lit_alone", "unlit", "unscanned")},
    )  # fmt: skip
