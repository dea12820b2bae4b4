"""Import: dark photographs from elsewhere in, a capture folder out, with all truth there is about them."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as capture_folder
from novags.testbed.folders.capture import has_view
from novags.testbed.folders.imported import SCAN, write_clean, write_depth
from novags.testbed.folders.photographs.raw_files import first_colors
from novags.testbed.folders.set import say_balances, say_stated
from novags.testbed.importing.clean import Match, match_clean, tone_gain
from novags.testbed.importing.dark import Dark, open_dark
from novags.testbed.importing.darkroom import Darkroom
from novags.testbed.importing.exposures import OF_CAMERA, OF_CLEAN, check_exposed_alike, check_iso, exposure_doubts
from novags.testbed.importing.pairs import pair_doubts
from novags.testbed.importing.published.datasets import DATASETS, Dataset, dataset_of
from novags.testbed.importing.published.realx3d import read_depth
from novags.testbed.importing.raw_camera import raw_camera
from novags.testbed.importing.stored import Codes16, is_lossy, read_stored
from novags.testbed.importing.twins import Twins, twins_by_order, twins_of, twins_of_lit_alone
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.capturing import files_of
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.paths import keep_apart
from sensor_model.files.dng import SMALLEST, write_dng
from sensor_model.isp import to_linear16
from sensor_model.params import Exposure
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png
from simscenes.sets.readers.ply_points import read_ply_points
from simscenes.sets.writers.neighbours import write_points

CODES = 6  # different ones in a picture, from which on a common divisor is no accident
PEDESTAL = 0.5  # share of the median code that one pixel in a hundred of a picture, its shadows and noise, is below
BRIGHTER, LOOKED_AT = 8.0, 4  # times; views of each kind. RealX3D's lit pictures have 40 times the light of the dark
SMALLEST_LIGHT = 1e-6  # of white: black pictures would divide by zero
OWN_TONE = 1.25  # or more times the light of the raw files is a camera's tone curve, not the rounding to 8 bits


@dataclass(frozen=True)
class ImportInput:
    """Everything an import reads."""

    dark: Dark
    lit: Twins | None
    clean: Twins | None
    dataset: Dataset | None

    def inputs(self) -> dict[str, str]:
        """Hashes of all files read, and their assumed meaning."""
        digests = {name: twins.digest() if twins else "" for name, twins in (("lit", self.lit), ("clean", self.clean))}
        return {"dark": self.dark.digest(), **digests, "dataset": self.dataset.name if self.dataset else ""}


@dataclass(frozen=True)
class PreparedImport:
    """The data that all views share."""

    darkroom: Darkroom
    match: Match | None
    resampled: int  # well-lit pictures that are brought to the size of the dark ones


def import_photographs(
    folder: Path, out: Path, config: ImportConfig, console: Console, *, overwrite: bool = False
) -> dict[str, Any]:
    """Make a capture folder of the dark photographs in `folder`; returns its capture.json.

    Raises:
        ValueError: If there are no pictures or cameras, a file cannot be read, twins do not fit, or `out` holds other
            things or, unless `overwrite`, a finished result of another request.
        BlockingIOError: If another process is writing to `out`.
    """
    for given in (folder, config.lit, config.clean):
        if given is not None:
            keep_apart(out, given)
    material = material_of(folder, config, console)
    return run_stage(
        "import",
        out,
        capture_folder.RECORD,
        code=config.code,
        inputs=material.inputs,
        config=config.resolved(),
        owns=capture_folder.OWNS,
        prepare=lambda: prepare(material, config, console),
        work=lambda prepared: import_views(material, prepared, out, config, console),
        console=console,
        overwrite=overwrite,
    )


def material_of(folder: Path, config: ImportConfig, console: Console) -> ImportInput:
    """Find everything that an import reads; only the headers of pictures are read.

    Raises:
        ValueError: As `import_photographs`.
    """
    if not folder.is_dir():
        raise ValueError(f"no such folder: {folder}")
    dataset = _dataset(folder, config.dataset)
    if dataset is not None:
        console.note(f"import: {folder} is taken for a scene of {dataset.name} (--dataset)")
    dark = open_dark(folder, dataset, config.split, config.max_size, console)
    views = dark.source.views
    lit, clean = (
        None if path is None else twins_of(views, path, option, console)
        for path, option in ((config.lit, "--lit"), (config.clean, "--clean"))
    )
    if lit is None and dataset is not None and (place := dataset.lit(folder)) is not None:
        lit = twins_by_order(views, place, console) if dataset.by_order else twins_of(views, place, "its", console)
    if clean is not None and views.lit_alone:
        raise ValueError(f"--clean needs a dark picture of every view, and {folder} has none of {len(views.lit_alone)} "
                         "held-out views: add --split every8, which leaves these out")  # fmt: skip
    if lit is None and views.lit_alone:
        lit = twins_of_lit_alone(views)
    if dataset is not None and lit is None and clean is None:
        console.note(f"import: {folder} has no lit pictures, so that there is nothing to score against (--lit)")
    return ImportInput(dark, lit, clean, dataset)


def _dataset(folder: Path, named: str) -> Dataset | None:
    if named in ("auto", "none"):
        return dataset_of(folder) if named == "auto" else None
    if not DATASETS[named].fits(folder):
        raise ValueError(f"{folder} must hold what a scene of {named} does: {DATASETS[named].layout}")
    return DATASETS[named]


def prepare(material: ImportInput, config: ImportConfig, console: Console) -> PreparedImport:
    """Read every file once, so that nothing is cleared for files that cannot be imported, and match the long exposures.

    Raises:
        ValueError: If a file cannot be read, is of another kind, size or exposure than the first, is turned beside its
            twin by a mark of orientation, or shows nothing.
    """
    dark = material.dark
    camera = raw_camera(dark.raws[0], config.camera, config.demosaic) if dark.raws else None
    darkroom = Darkroom(
        views=dark.source.views, rig=dark.source.rig, codes=config.codes, lit_codes=config.codes, camera=camera,
        lit_colors=None if material.lit is None else first_colors(material.lit.there),
    )  # fmt: skip
    files = [(file, False) for group in (dark.dark_files, dark.raws) for file in group]
    given = [twins for twins in (material.lit, material.clean) if twins is not None]
    files += [(file, twins is material.lit) for twins in given for file in twins.there]
    total = len(files) + (len(dark.files) if material.clean else 0)
    match, resampled, depths, lit16 = None, 0, set[str](), list[Path]()
    with console.progress("import: files") as progress:
        for done, (file, lit) in enumerate(files):
            depth, off = darkroom.check(file, lit=lit)
            resampled += off
            depths.add(depth)
            lit16 += [file] if lit and depth == "16bit" else []
            if done < len(dark.dark_files) and depth != dark.depth:
                raise ValueError(f"{file} is {depth}, {dark.dark_files[0].name} {dark.depth}: import files of one kind")
            progress(done + 1, total, file.name)
        if material.clean is not None:
            match = match_clean(dark, material.clean.there, darkroom, progress, len(files), total)
            _say_tone(tone_gain(dark, darkroom), console)
    if config.time is None:
        for group in dict.fromkeys((dark.dark_files, dark.raws)):  # raw files alone are both
            check_exposed_alike(group)
    if config.iso is not None:
        check_iso((*dark.dark_files, *dark.raws), OF_CAMERA, config.iso, f"--sensor {config.sensor_name}")
    if material.clean is not None:
        check_exposed_alike(material.clean.there, OF_CLEAN)
    if material.lit is not None:
        for doubt in exposure_doubts(material.lit.there):
            console.warn(f"{material.lit.folder}: {doubt}")
    if resampled:
        console.warn(f"{resampled} of {len(dark.files)} lit pictures are a pixel larger or smaller than the dark ones: "
                     "resampled to their size")  # fmt: skip
    if "16bit" not in depths:
        _say_no_codes(config.codes, console)
    if lit16:
        darkroom = replace(darkroom, lit_codes=config.codes.for_twins(lit16))
        _say_codes("well-lit 16-bit files", darkroom.lit_codes, lit16, console)
    _say(material, darkroom, config, match, console)
    return PreparedImport(darkroom, match, resampled)


def _say_tone(gain: float, console: Console) -> None:
    if not 1 / OWN_TONE < gain < OWN_TONE:
        console.warn(
            f"the pictures show {gain:.3g} times the light of their raw files, to which the clean exposures are "
            "matched: they have a tone of their own, which counts as an error in scores against clean exposures. "
            "Import the raw files alone, and pictures are developed from them"
        )


def _say_no_codes(codes: Codes16, console: Console) -> None:
    """Say that options on 16-bit codes have no effect where no file has 16 bits."""
    changed = {one.name: value for one in fields(codes) if (value := getattr(codes, one.name)) != one.default}
    given = [f"--{name} {value if isinstance(value, str) else f'{value:g}'}" for name, value in changed.items()]
    if given:
        console.warn(f"no picture here has 16 bits, so these options have no effect: {', '.join(given)}")


def _say_codes(what: str, codes: Codes16, files: Sequence[Path], console: Console) -> None:
    """How 16-bit files are read."""
    curves = dict.fromkeys(codes.of(file).curve for file in files)
    says = ", as the files say" if codes.curve == "auto" and {*curves} != {"linear"} else ""
    console.note(f"import: {what}: code {codes.black:g} is black, {codes.white:g} white, {' or '.join(curves)} in "
                 f"between{says} (--black, --white, --curve)")  # fmt: skip


def _say_odd(file: Path, levels: Codes16, console: Console) -> None:
    """Say that codes stand apart, as those of fewer bits do that are stored at the top of 16, or far above black."""
    stored = read_stored(file)
    least, middle = np.quantile(stored, (0.01, 0.5))
    if not levels.black and levels.of(file).curve == "linear" and least > PEDESTAL * middle:
        console.warn(f"99 % of the codes of {file.name} are above {least:.0f}, and half of them below {middle:.0f}: "
                     "probably the camera's black level is in them and counts as light; give --black")  # fmt: skip
    codes = np.unique(stored)
    step = int(np.gcd.reduce(codes)) if len(codes) >= CODES else 1
    if step > 1:
        console.warn(f"codes of {file.name} are multiples of {step}: they are probably of "
                     f"{16 - (step.bit_length() - 1)} bits, stored at the top of 16, so that --black is {step} times "
                     "the camera's own")  # fmt: skip


def _say(
    material: ImportInput, darkroom: Darkroom, config: ImportConfig, match: Match | None, console: Console
) -> None:
    """Assumptions about the photographs, and losses in the import."""
    dark = material.dark
    for group in (dark.raws, () if material.lit is None else material.lit.there):
        say_balances(group, console)
    if alone := dark.source.views.lit_alone:
        console.note(f"import: {len(alone)} held-out views are known in good light only: they are scored, and have no "
                     "dark picture")  # fmt: skip
    elif (times := held_out_brighter(dark, darkroom)) > BRIGHTER:
        console.warn(f"held-out pictures of {dark.source.views.path} are {times:.0f} times as bright as the others: "
                     "if they are lit ones, as of RealX3D, give --dataset; else every score is wrong")  # fmt: skip
    for file in dict.fromkeys((*dark.dark_files, *dark.raws)):
        say_stated(file, dark.source.views.path, console)
    for doubt in dark.source.picture_doubts(lambda i: darkroom.srgb8(dark.files[i], i)):
        console.warn(f"{dark.source.views.path}: {doubt}")
    _say_pairs(material, darkroom, console)
    if dark.depth == "16bit":
        _say_codes("16-bit files", config.codes, dark.dark_files, console)
        _say_odd(dark.dark_files[0], config.codes, console)
    if darkroom.resampled and (dark.raws or config.camera):
        kept = "no raw frames" if dark.raws else ""
        noise = "no known noise" if config.camera else ""
        console.note(f"import: {darkroom.resampled}: {' and '.join(filter(None, (kept, noise)))}")
    elif dark.raws and min(darkroom.rig.width, darkroom.rig.height) < SMALLEST:
        raise ValueError(
            f"raw frames must be {SMALLEST} px wide and high or more, got {darkroom.rig.width} x {darkroom.rig.height}"
        )
    if match is not None:
        console.note(f"import: the dark pictures have {match.gain:.4g} times the light of the clean ones")
        if match.white_share > 0.001:
            console.warn(f"{match.white_share:.1%} of the clean pictures is white, where they are too dark a reference")


def _say_pairs(material: ImportInput, darkroom: Darkroom, console: Console) -> None:
    """Doubts whether twins, and pictures beside raw files, show their views."""
    dark = material.dark
    own = dark.raws or dark.files
    pairs = [(twins.folder, own, twins.files) for twins in (material.lit, material.clean) if twins is not None]
    for folder, ones, others in [*pairs, (dark.source.views.path, own, dark.files)]:
        both = {i: (one, other) for i, (one, other) in enumerate(zip(ones, others, strict=True))
                if other not in (None, one) and i not in dark.source.views.lit_alone}  # fmt: skip
        for doubt in pair_doubts(both, darkroom.small):
            console.warn(f"{folder}: {doubt}")


def held_out_brighter(dark: Dark, darkroom: Darkroom) -> float:
    """How many times as much light the held-out pictures have as the others, by the median of a few of each; 1 where
    the folder itself holds none out.
    """
    views = dark.source.views
    if views.held_out is None:
        return 1.0
    tested, others = (
        np.median([darkroom.linear(dark.files[i], i).mean() for i in indices[:: -(-len(indices) // LOOKED_AT)]])
        for indices in (views.test_indices, views.train_indices)
    )
    return float(tested / max(others, SMALLEST_LIGHT))


def import_views(
    material: ImportInput, prepared: PreparedImport, folder: Path, config: ImportConfig, console: Console
) -> dict[str, Any]:
    """Write every view that is not complete yet, then the cameras; returns the body of capture.json.

    Raises:
        ValueError: If a file cannot be read.
    """
    dark, darkroom = material.dark, prepared.darkroom
    views, rig = dark.source.views, darkroom.rig
    with console.progress("import") as progress:
        for i, name in enumerate(views.names):
            if not has_view(folder, name, "lit" if i in views.lit_alone else "images"):
                import_view(material, prepared, i, name, folder, exposure_of(config, darkroom))
            progress(i + 1, len(views), f"view {name}")
    write_cameras(
        folder, views.names, rig, points=dark.source.points(), held_out=views.test_indices, scene=views.scene,
        lit_alone=views.lit_alone,
    )  # fmt: skip
    if (scan := dark.beside.get("scan")) is not None:
        from novags.testbed.metrics.geometry import thinned  # scipy comes with it

        points = thinned(read_ply_points(scan, most=None).about(views.origin).xyz)
        write_points(folder / SCAN, points, np.full(points.shape, 128, np.uint8))
    return record_of(material, prepared, config)


def import_view(
    material: ImportInput, prepared: PreparedImport, i: int, name: str, folder: Path, exposure: Exposure
) -> None:
    """Write all forms of one view; the 8-bit picture, which says that the view is complete, last."""
    dark, darkroom = material.dark, prepared.darkroom
    if (scanned := dark.beside.get(f"depth/{name}")) is not None:
        write_depth(folder, name, read_depth(scanned, darkroom.rig.width, darkroom.rig.height))
    if material.lit is not None and (lit := material.lit.files[i]) is not None:
        write_png(folder / "lit" / f"{name}.png", darkroom.lit8(lit, i))
    if i in dark.source.views.lit_alone:
        return
    if material.clean is not None and prepared.match is not None and (clean := material.clean.files[i]) is not None:
        light = darkroom.linear(clean, i) * np.float32(prepared.match.gain)
        write_clean(folder, name, light)
    if holds_raw(dark, darkroom):
        dn, sensor = darkroom.frame(dark.raws[i])
        assert darkroom.camera is not None
        matrix = darkroom.camera.format.color_matrix
        write_dng(folder / "raw" / f"{name}.dng", dn, sensor, exposure, color_matrix=matrix)
    if dark.raws or dark.depth == "16bit":
        light = darkroom.linear(dark.raws[i] if dark.raws else dark.files[i], i)
        write_png(folder / "images16" / f"{name}.png", to_linear16(light))
    write_png(folder / "images" / f"{name}.png", darkroom.srgb8(dark.files[i], i))


def holds_raw(dark: Dark, darkroom: Darkroom) -> bool:
    """Whether raw frames of the capture's pixels exist."""
    return bool(dark.raws) and darkroom.resampled is None


def exposure_of(config: ImportConfig, darkroom: Darkroom) -> Exposure:
    """The exposure, of unknown time (0) if neither the user nor the raw files say it."""
    stated = None if darkroom.camera is None else darkroom.camera.format.time
    return Exposure(time=next((time for time in (config.time, stated) if time is not None), 0.0))


def record_of(material: ImportInput, prepared: PreparedImport, config: ImportConfig) -> dict[str, Any]:
    """The body of capture.json."""
    dark, darkroom, match = material.dark, prepared.darkroom, prepared.match
    camera, raw = darkroom.camera, None
    if camera is not None and holds_raw(dark, darkroom):
        sensor = darkroom.frame(dark.raws[0])[1]
        raw = {"cfa": sensor.cfa, "black": sensor.black_level, "white": sensor.white_dn}
    sixteen = bool(dark.raws) or dark.depth == "16bit"
    jpeg = any(is_lossy(file) for file in dark.dark_files)
    views, lit = dark.source.views, material.lit
    scanned = [name for name in views.names if f"depth/{name}" in dark.beside]
    parts = {"images16": sixteen, "raw": raw is not None, "truth": match is not None, "lit": material.lit is not None,
             "depth": bool(scanned), "scan": "scan" in dark.beside}  # fmt: skip
    unlit = [] if lit is None else [name for name, file in zip(views.names, lit.files, strict=True) if file is None]
    incomplete = {"lit_alone": [views.names[i] for i in views.lit_alone], "unlit": unlit,
                  "unscanned": [name for name in views.names if scanned and name not in scanned]}  # fmt: skip
    return {
        "kind": "imported",
        "scene": Path(os.path.abspath(dark.source.views.path)).name,
        "files": files_of(dark.source),
        "depth": dark.depth,
        "parts": [part for part, there in parts.items() if there],
        "raw": raw,
        "jpeg": jpeg,
        "sensor_name": config.sensor_name,
        "sensor": camera.sensor if camera is not None and camera.known else config.camera,
        "exposure": exposure_of(config, darkroom),
        "demosaic": config.demosaic,
        "color_matrix": None if camera is None else camera.format.color_matrix,
        "resampled": darkroom.resampled,
        "lit": None if material.lit is None else material.lit.record() | {"resampled": prepared.resampled},
        "dataset": None if material.dataset is None else material.dataset.name,
        "split": config.split,
        "clean": None if material.clean is None or match is None else material.clean.record() | asdict(match),
        **{what: names for what, names in incomplete.items() if names},
        "views": len(dark.source.views),
        "width": darkroom.rig.width,
        "height": darkroom.rig.height,
    }
