"""Capture: photograph a multiview set in the dark, one exposure or burst per view, view by view."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.console.terminal import Console, Update
from novags.testbed.folders import capture as capture_folder
from novags.testbed.folders.capture import has_view, write_view
from novags.testbed.folders.place import keep_place, recorded_place
from novags.testbed.folders.set import Source, open_source
from novags.testbed.importing.exposures import dark_doubts, exposure_doubts, say_time
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.configs.capturing import CaptureConfig, camera_file
from novags.testbed.stages.layouts import LAYOUTS, check_source_of, truth_of, write_layouts
from novags.testbed.stages.paths import keep_apart
from novags.warm import compile_ahead
from sensor_model.capture import RawFrame, clean_response, expose_burst, mean_of
from sensor_model.files.camera_file import read_maps
from sensor_model.files.dng import SMALLEST
from sensor_model.files.lock import locked
from sensor_model.frame.measured import Measured
from sensor_model.frame.uneven import EVEN, Uneven, draw_uneven
from sensor_model.mosaicking import mosaic
from sensor_model.params import Exposure, Sensor
from sensor_model.plan import Plan
from sensor_model.planner import plan_effects
from sensor_model.radiometry import photons_for_electrons
from simscenes.sets.multiview import write_cameras

QUANTILES = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)
PIXELS_PER_VIEW, PIXELS = 1365, 350_000  # kept for the quantiles of the signal: enough for the 1 % ones
NO_LIGHT = {  # what to do about a black set of each kind
    "rendered": "none reaches its cameras: add an emitter to the scene, or check that one faces their view",
    "photographs": "check that its pictures are right",
}


def capture(
    set_path: Path,
    out: Path,
    config: CaptureConfig,
    console: Console,
    *,
    stale: Sequence[Path] = (),
    overwrite: bool = False,
    for_runs: bool = False,
) -> dict[str, Any]:
    """Photograph the set at `set_path` in the dark; returns capture.json.

    Args:
        set_path: The set.
        out: Folder of the capture.
        config: Camera and light.
        console: Where progress goes.
        stale: See `stages`.
        overwrite: Replace a finished result of another request.
        for_runs: Whether methods will read the capture; they need its raw files.

    Raises:
        ValueError: If the set cannot be read or is black, its images are too small `for_runs`, or `out` holds other
            things or, unless `overwrite`, a finished result of another request.
        BlockingIOError: If another process is writing to `out`.
    """
    keep_apart(out, set_path)
    source = open_source(set_path, console, config.max_size)
    check_source_of(config.export, source)
    if config.bracket and len(source.views) < 2:
        raise ValueError(f"bracket interleaves two exposures: it needs 2 views or more, and {source.title} has 1")
    if min(source.rig.width, source.rig.height) < SMALLEST:
        said = (
            f"images of {source.rig.width} x {source.rig.height} px make raw files that LibRaw refuses: it takes "
            f"{SMALLEST} px of either side or more"
        )
        if for_runs:
            raise ValueError(f"{said}, and methods read them: take larger images")
        console.warn(f"{said}. novags reconstruct needs larger images, all other files of this capture are as usual")
    with locked(out):
        record = run_stage(
            "capture",
            out,
            capture_folder.RECORD,
            code=config.code.along_with(source.modules),
            opened={"set": source.content},
            inputs=lambda: {"set": source.digest()},
            config=config.resolved(),
            owns=(*capture_folder.OWNS, *LAYOUTS),
            prepare=lambda: look_and_meter(source, config, console),
            work=lambda light: capture_views(source, light, out, config, console),
            console=console,
            stale=stale,
            overwrite=overwrite,
        )
        keep_place(out, record["set"]["path"], source.views.path)
        write_layouts(out, config.export, console, truth=truth_of(source))
    return record


def camera_for(source: Source, config: CaptureConfig) -> Sensor:
    """The camera; with the colour filters that a set was rendered through, if it was."""
    return config.camera if source.response is None else replace(config.camera, rgb_response=source.response)


@dataclass(frozen=True)
class Light:
    """The data that all views of a capture share, because one exposure is common to them."""

    mean_green: float  # radiance over the set
    signal_e: np.ndarray  # `QUANTILES` of the charge in the sensor's channels, e-
    sensor: Sensor  # with dark frames, in their numbers
    measured: Measured  # maps and dark frames of the camera
    plan: Plan | None  # which effects to simulate; None: all of them
    uneven: Uneven = EVEN  # how single views differ


def look_and_meter(source: Source, config: CaptureConfig, console: Console) -> Light:
    """The result of `meter`, after doubts about photographs were said."""
    if source.views.kind == "photographs":
        views = source.views
        for doubt in [*exposure_doubts(views.files), *dark_doubts(views), *source.picture_doubts()]:
            console.warn(f"{views.path}: {doubt}")
    return meter(source, config, console)


def meter(source: Source, config: CaptureConfig, console: Console, pixels: int | None = None) -> Light:
    """Measure the light of a whole set, view by view, and plan its capture.

    Args:
        source: The set.
        config: Camera and light.
        console: Where progress goes.
        pixels: Of an image of the capture; None: the source's.

    Raises:
        ValueError: If the set is black or holds bad radiance.
    """
    measured = measured_of(source, config, console)
    sensor = measured.dark.described if measured.dark else camera_for(source, config)
    uneven = uneven_of(sensor, len(source.views), config)
    with console.progress("capture: light") as progress:
        mean_green, signal = measure_light(source, sensor, progress, uneven)
    signal_e = signal * config.electrons / mean_green
    if (median := signal_e[QUANTILES.index(0.5)]) >= sensor.capacity_e:
        console.warn(
            f"at {config.electrons:g} electrons more than half of the signal is white: its median is {median:.3g} e-, "
            f"and {config.sensor_name} saturates at {sensor.capacity_e:.3g} e-; take fewer electrons"
        )
    if (limits := config.limits(pixels or source.rig.width * source.rig.height)) is None:
        return Light(mean_green, signal_e, sensor, measured, None, uneven)
    longest = lengthened(config.exposure, max(uneven.exposures, default=1.0))
    plan = plan_effects(sensor, longest, signal_e, limits)
    return Light(mean_green, signal_e, sensor, measured, measured.said(plan), uneven)


def measured_of(source: Source, config: CaptureConfig, console: Console) -> Measured:
    """What was measured of the camera's pixels, of the middle of its sensor: the same part for all views.

    Raises:
        ValueError: If it does not fit the camera or the pictures.
    """
    size, file = (source.rig.height, source.rig.width), camera_file(config.sensor)
    found = Measured() if file.maps is None else read_maps(file.maps, size)
    if config.dark_frames is None:
        if found.time is not None:
            say_time(f"maps: the dark frames behind {file.maps} were", found.time, config.time, console)
        return found
    return replace(found, dark=config.dark_folder(file).read(camera_for(source, config), size, config.time, console))


def uneven_of(sensor: Sensor, views: int, config: CaptureConfig) -> Uneven:
    """How the views differ."""
    if not config.uneven:
        return EVEN
    return draw_uneven(
        sensor, views, seed=config.noise_seed, exposure_spread=config.exposure_spread,
        white_balance_spread=config.white_balance_spread, bracket=config.bracket,
    )  # fmt: skip


def lengthened(exposure: Exposure, factor: float) -> Exposure:
    """The same with so many times its time."""
    return replace(exposure, time=exposure.time * factor)


def capture_views(
    source: Source, light: Light, folder: Path, config: CaptureConfig, console: Console
) -> dict[str, Any]:
    """Expose every view of the source and write it; views that are complete are kept. One is in memory at a time.

    Returns:
        The body of capture.json.

    Raises:
        ValueError: If the set holds bad radiance.
    """
    sensor, exposure, plan, uneven = light.sensor, config.exposure, light.plan, light.uneven
    names = source.views.names
    compile_ahead("camera", console.note)
    with console.progress("capture") as progress:
        for i, name in enumerate(names):
            if not has_view(folder, name):
                frame, clean = expose_with_truth(
                    source.radiance(i), sensor, exposure, electrons=config.electrons, mean_green=light.mean_green,
                    seed=config.noise_seed, view=i, plan=plan, times=uneven.times(i), frames=config.burst,
                    measured=light.measured,
                )  # fmt: skip
                write_view(
                    folder, name, frame, sensor, config.demosaic, source.color_matrix, config.jpeg_quality,
                    clean_rgb=clean, seen_by=uneven.seen_by(sensor, i),
                )  # fmt: skip
            progress(i + 1, len(names), f"view {name}")
    write_cameras(
        folder, names, source.rig, points=source.points(), held_out=source.views.test_indices, scene=source.views.scene
    )
    return {
        "set": {
            "path": recorded_place(folder, source.views.path),
            "kind": source.views.kind,
            "max_size": config.max_size,
            "background": "white" if source.views.transparent else None,  # behind transparent pixels
            **({} if source.codes16 is None else {"codes16": source.codes16}),
        },
        "scene": source.views.scene,
        "sensor_name": config.sensor_name,
        "sensor": sensor,
        "exposure": exposure,
        **({} if config.burst == 1 else {"burst": config.burst}),
        **({"uneven": {"exposures": uneven.exposures, "balances": uneven.balances}} if uneven.exposures else {}),
        "electrons": config.electrons,
        "mean_green_radiance": light.mean_green,
        "signal_quantiles_e": dict(zip(map(str, QUANTILES), light.signal_e.tolist(), strict=True)),
        "demosaic": config.demosaic,
        "color_matrix": source.color_matrix,
        "jpeg_quality": config.jpeg_quality,
        "seed": config.seed,
        **({} if config.noise_seed == config.seed else {"noise_seed": config.noise_seed}),
        "views": len(names),
        "width": source.rig.width,
        "height": source.rig.height,
        "plan": None if plan is None else plan.to_dict(),
        **dict(config.measured),
        **({"files": files_of(source)} if source.views.renamed else {}),
    }


def expose_view(
    radiance: np.ndarray, sensor: Sensor, exposure: Exposure, *, electrons: float, mean_green: float, seed: int,
    view: int, plan: Plan | None = None, times: float = 1.0, frames: int = 1, measured: Measured | None = None,
) -> RawFrame:  # fmt: skip
    """One exposure of linear RGB [h,w,3], scaled so that green of `mean_green` gives so many electrons.

    Args:
        radiance: The light.
        sensor: The camera.
        exposure: How it is used; common to all views.
        electrons: Of the common exposure.
        mean_green: Light that gives them.
        seed: Of the noise.
        view: Which.
        plan: As for `expose`.
        times: The exposure of this view over the common one.
        frames: Of a burst, whose mean it is.
        measured: As for `expose`.

    Raises:
        ValueError: If the light or a number is out of range.
    """
    photons = photons_for_electrons(radiance, electrons=times * electrons, mean_green=mean_green, sensor=sensor)
    seen = mosaic(photons, sensor.cfa) if sensor.cfa else photons
    used = lengthened(exposure, times)
    burst = expose_burst(seen, sensor, used, frames=frames, seed=seed, view=view, plan=plan, measured=measured)
    return replace(mean_of(burst), times=times)


def expose_with_truth(
    radiance: np.ndarray, sensor: Sensor, exposure: Exposure, *, electrons: float, mean_green: float, **how: Any
) -> tuple[RawFrame, np.ndarray | None]:
    """One exposure as `expose_view` takes it; for a mosaic also the common signal of its three channels without noise.

    Returns:
        The frame; and DN [h,w,3] as from three chips of the same camera, without the effects that the plan leaves out.
        None for three chips, whose frame holds it already (`RawFrame.clean_dn`).
    """
    frame = expose_view(radiance, sensor, exposure, electrons=electrons, mean_green=mean_green, **how)
    if sensor.cfa is None:
        return frame, None
    photons = photons_for_electrons(radiance, electrons=electrons, mean_green=mean_green, sensor=sensor)
    return frame, clean_response(photons, replace(frame.sensor, cfa=None), exposure)


def files_of(source: Source) -> dict[str, str]:
    """The file of each view, relative to the set, by the view's name."""
    views = source.views
    return {name: os.path.relpath(file, views.path) for name, file in zip(views.names, views.files, strict=True)}


def measure_light(source: Source, sensor: Sensor, progress: Update, uneven: Uneven = EVEN) -> tuple[float, np.ndarray]:
    """Mean green radiance over the set, and `QUANTILES` of the light on the sensor's channels, in the same unit.

    Args:
        source: The set.
        sensor: The camera.
        progress: Told of each view.
        uneven: Exposures of the views; they count in the quantiles.

    Raises:
        ValueError: If every view is black in green.
    """
    total, samples, least, most = 0.0, [], np.inf, 0.0
    count = len(source.views)
    kept = max(1, min(PIXELS_PER_VIEW, PIXELS // count))  # of each view, so that all together stay small
    for i in range(count):
        radiance = source.radiance(i)
        total += float(radiance[..., 1].mean(dtype=np.float64)) / count
        seen = radiance * np.asarray(sensor.rgb_response, np.float32) * np.float32(uneven.times(i))
        samples.append(some_pixels(seen, kept))
        least, most = min(least, float(seen.min())), max(most, float(seen.max()))
        progress(i + 1, count, f"view {source.views.names[i]}")
    if not total > 0:
        raise ValueError(f"the green channel of {source.title} is black, so electrons cannot be set by it; "
                         f"{NO_LIGHT[source.views.kind]}")  # fmt: skip
    quantiles = np.quantile(np.concatenate(samples).astype(np.float64), QUANTILES)
    quantiles[0], quantiles[-1] = least, most  # exact: saturation depends on the brightest pixel
    return total, quantiles


def some_pixels(image: np.ndarray, count: int) -> np.ndarray:
    """About `count` pixels [n,3] of an image [h,w,3], spread evenly over rows and columns."""
    height, width = image.shape[:2]
    stride = max(1, height * width // count)
    while math.gcd(stride, width) > 1:  # else it would hit the same columns in every row
        stride += 1
    return image.reshape(-1, 3)[::stride].copy()  # a view would keep the whole image in memory
