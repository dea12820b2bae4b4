"""The command line. Thin: every command turns its arguments into a configuration and calls the test bed."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import tyro

from novags.failure import errors_in_one_line
from novags.inquiries import doctor, help_, list_
from novags.options import LIGHT, Device, Folder, Light, Name, PresetName, Repeated

if TYPE_CHECKING:  # heavy: torch and its friends load when a command runs, so that --help answers at once
    from novags.methods.variant import Variant
    from novags.testbed.console import Console


def run(
    *,
    preset: PresetName = "demo",
    scene: str | None = None,
    sensor: str | None = None,
    electrons: float | None = None,
    out: Path | None = None,
    methods: tuple[str, ...] | None = None,
    variant: Repeated = (),
    cameras: str | None = None,
    refine_cameras: bool = False,
    views: int | None = None,
    width: int | None = None,
    height: int | None = None,
    spp: int | None = None,
    points: int | None = None,
    iterations: int | None = None,
    denoiser_steps: int | None = None,
    seed: int | None = None,
    device: Device = "auto",
    wait: bool = False,
) -> None:
    """Run a whole experiment: render, capture in the dark, reconstruct with several methods, score, report.

    Finished work is kept: the same command again does only what is missing.

    Args:
        preset: Source of every setting that is not given here.
        scene: A scene of the catalogue ("tabletop", or "tabletop:3" for its variation 3), or a Mitsuba .xml file.
        sensor: A camera of sensor_model.PRESETS, or a TOML file of your own.
        electrons: Mean signal of the green channel over the set, electrons per pixel and exposure.
        out: Folder of the experiment; out/PRESET if not given.
        methods: Methods and variants to compare; `novags list methods` names them.
        variant: A method with settings changed, NAME=METHOD:SETTING=VALUE,SETTING=VALUE, compared as well; may be given
            several times. Or a TOML file with tables [variant.NAME].
        cameras: Where cameras come from: known, known:rotation_deg=1, sfm, vggt:checkpoint=FILE; see `novags help
            cameras`.
        refine_cameras: Let every fit correct its training cameras.
        views: Number of views.
        width: Image width in pixels.
        height: Image height in pixels.
        spp: Samples per pixel of the render.
        points: Gaussians at the start.
        iterations: Of the fit.
        denoiser_steps: Of the denoiser before the fit starts.
        seed: Of noise and training.
        device: Where training runs; auto takes a GPU if there is one that can be used.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed import experiment
    from novags.testbed.presets import EXPERIMENTS, adapted

    chosen = adapted(
        EXPERIMENTS[preset], scene=scene, sensor=sensor, electrons=electrons, methods=methods, n_views=views,
        width=width, height=height, spp=spp, points=points, iterations=iterations,
        denoiser_steps=denoiser_steps, seed=seed,
        variants=_variants(variant), cameras=_cameras(cameras), refine_cameras=refine_cameras, device=device,
    )  # fmt: skip
    folder = out if out is not None else Path("out") / preset
    with _writing(folder, wait) as console:
        report_path = experiment.run(chosen, folder, console, command=_command_line())
    _announce(report_path)


def plan(
    scene: Name, *, sensor: str, electrons: float, time: float = 1 / 30, preset: PresetName = "demo",
    width: int | None = None, height: int | None = None, tolerance: float = 0.05, light_tolerance: float = 0.02,
    light: Light = LIGHT,
) -> None:  # fmt: skip
    """Show what would be simulated, what would not, why, and the bound on the error of leaving it out.

    Args:
        scene: A multiview set folder, a scene of the catalogue, or a Mitsuba .xml file.
        sensor: A camera of sensor_model.PRESETS, or a TOML file of your own.
        electrons: Mean signal of the green channel over the set, electrons per pixel and exposure.
        time: Exposure time in seconds; only the dark current depends on it.
        preset: Source of the image size where it is not given here, unless the scene is a folder.
        width: Image width in pixels; with more pixels, rarer defects of the sensor count.
        height: Image height in pixels.
        tolerance: Allowed relative error of the noise's standard deviation.
        light_tolerance: Share of all light that may be wrong or missing.
        light: How light gets from the lamps to the sensor.
    """
    from novags.testbed.forecast import PILOT, light_plan, sensor_plan
    from novags.testbed.presets import EXPERIMENTS, adapted
    from novags.testbed.stages.capture import CaptureConfig

    config, console = CaptureConfig(sensor=sensor, electrons=electrons, time=time, tolerance=tolerance), _console()
    size = adapted(EXPERIMENTS[preset], width=width, height=height).render
    pilot = replace(PILOT, scene=scene, **light.settings())
    # Blur is weighed in pixels and in steps between views: those of the real images, not of the pilot.
    views = replace(pilot, n_views=size.n_views, width=size.width, height=size.height)
    found = light_plan(views, light_tolerance, console)
    print(f"Light of {scene}: {'as it is in the folder' if found is None else ''}\n{found or ''}".rstrip())
    noise, signal_e = sensor_plan(pilot, config, size.width * size.height, console)
    signal = ", ".join(f"{name} {value:.3g} e-" for name, value in signal_e.items())
    print(f"\nCamera {sensor}, mean green signal {electrons:g} e-; {signal}\n{noise}")


def render(
    scene: Name, *, out: Path, views: int = 32, width: int = 128, height: int = 128, spp: int | None = None,
    target_error: float | None = None, light: Light = LIGHT,
    export: tuple[Literal["blender", "llff"], ...] = (), seed: int = 0, wait: bool = False,
) -> None:  # fmt: skip
    """Render a scene into a ground-truth multiview set.

    Args:
        scene: A scene of the catalogue ("tabletop", or "tabletop:3" for its variation 3), or a Mitsuba .xml file.
        out: Folder of the set.
        views: Number of views.
        width: Image width in pixels.
        height: Image height in pixels.
        spp: Samples per pixel; 256 if neither this nor target_error is given.
        target_error: Relative error at which each view stops instead.
        light: How light gets from the lamps to the sensor.
        export: Further layouts of the set to write, each into a folder of its own in it.
        seed: Of the Monte Carlo noise.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed import stages
    from novags.testbed.stages.render import RenderConfig

    samples = 256 if spp is None and target_error is None else spp
    config = RenderConfig(
        scene=scene, n_views=views, width=width, height=height, spp=samples, target_error=target_error,
        export=export, seed=seed, **light.settings(),
    )  # fmt: skip
    with _writing(out, wait) as console:
        stages.render(out, config, console)
    print(out)
    _next(f"novags capture {out} --electrons 20 --out CAPTURE")


def capture(
    set: Folder, *, out: Path, sensor: str = "a7s2-iso6400-3chip", electrons: float = 20.0, time: float = 1 / 30,
    max_size: int | None = None, demosaic: Literal["menon", "malvar", "bilinear"] = "menon",
    jpeg_quality: int | None = None, tolerance: float | None = 0.05, seed: int = 0,
    wait: bool = False,
) -> None:  # fmt: skip
    """Photograph a multiview set in the dark: a rendered one, or real posed photographs.

    Args:
        set: A set folder, a nerfstudio or instant-ngp folder (transforms.json with 8-bit images, camera raw files or
            linear EXR), or a COLMAP folder (sparse/0, images).
        out: Folder of the capture.
        sensor: A camera of sensor_model.PRESETS, or a TOML file of your own.
        electrons: Mean signal of the green channel over the set, electrons per pixel and exposure.
        time: Exposure time in seconds; only the dark current depends on it.
        max_size: Scale larger images down to this longest side, in pixels.
        demosaic: Interpolation of the colour filter array.
        jpeg_quality: 1 to 100: put the 8-bit pictures through JPEG.
        tolerance: Leave out effects that change the noise by less than this share; None simulates all.
        seed: Of the noise.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed import stages
    from novags.testbed.stages.capture import CaptureConfig

    config = CaptureConfig(
        sensor=sensor, electrons=electrons, time=time, max_size=max_size, demosaic=demosaic,
        jpeg_quality=jpeg_quality, tolerance=tolerance, seed=seed,
    )  # fmt: skip
    with _writing(out, wait) as console:
        stages.capture(set, out, config, console)
    print(out)
    _next(f"novags reconstruct {out} --method nova-fast --out RUN")


def reconstruct(
    capture: Folder, *, out: Path, method: str = "nova-fast", variant: str | None = None, preset: PresetName = "demo",
    pictures: Literal["8bit", "16bit"] | None = None, cameras: str | None = None, refine_cameras: bool = False,
    points: int | None = None, iterations: int | None = None, denoiser_steps: int | None = None, seed: int = 0,
    device: Device = "auto", wait: bool = False,
) -> None:  # fmt: skip
    """Reconstruct a capture with one method: a 3D model, and pictures rendered from it.

    Args:
        capture: Folder of the capture.
        out: Folder of the run.
        method: A method or variant; `novags list methods` names them.
        variant: Instead of a method: a method with settings changed, NAME=METHOD:SETTING=VALUE,SETTING=VALUE.
        preset: Source of every setting of the method that is not given here.
        pictures: Which pictures the method sees: 8-bit sRGB, or 16-bit linear ones; its own choice if not given.
        cameras: Where cameras come from: known, known:rotation_deg=1, sfm, vggt:checkpoint=FILE; see `novags help
            cameras`.
        refine_cameras: Let the fit correct its training cameras.
        points: Gaussians at the start.
        iterations: Of the fit.
        denoiser_steps: Of the denoiser before the fit starts.
        seed: Of training.
        device: Where training runs; auto takes a GPU if there is one that can be used.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed import stages
    from novags.testbed.presets import EXPERIMENTS, adapted

    own = _variants(() if variant is None else (variant,))
    name = own[0].name if own else method
    chosen = adapted(
        EXPERIMENTS[preset], methods=(name,), variants=own, cameras=_cameras(cameras), refine_cameras=refine_cameras,
        points=points, iterations=iterations, denoiser_steps=denoiser_steps, pictures=pictures, device=device,
    )  # fmt: skip
    config = replace(chosen.reconstruct(name), seed=seed)
    with _writing(out, wait) as console:
        stages.reconstruct(capture, out, config, console)
    print(out)
    _next(f"novags score {out} && novags report {out}")


def score(run: Folder, *, wait: bool = False) -> None:
    """Score a run, or every run of an experiment, against the truth; write metrics.json.

    Args:
        run: Folder of a run or of an experiment.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.experiment import score_all

    with _writing(run, wait, make=False) as console:
        scores = score_all(run, console)
    for name, mean in scores.items():
        lit = mean["lit"]
        against = f"well lit {_decibels(lit['tone_aligned_psnr'])} (tone-aligned PSNR)"
        if "enhanced" in mean:
            against = f"noise-free exposure {_decibels(mean['enhanced']['aligned_psnr'])} (aligned PSNR), {against}"
        print(f"{name}: {against}")
    _next(f"novags report {run}")


def _decibels(score: float | None) -> str:
    return "not scored, because the reference shows nothing" if score is None else f"{score:.2f} dB"


def report(folder: Folder, *, wait: bool = False) -> None:
    """Write report.html for a scored run or experiment: one self-contained file.

    Args:
        folder: Folder of a run or of an experiment.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.report.page import write_report

    with _writing(folder, wait, make=False) as console:
        path = write_report(folder, console)
    _announce(path)


def characterise(folder: Folder, *, out: Path, window: int = 1024, wait: bool = False) -> None:
    """Estimate a camera from its dark and flat frames, and write it as a TOML file for --sensor.

    Args:
        folder: dark/NAME/* and flat/NAME/*, each NAME some frames of one exposure (raw files, 16-bit PNG or TIFF, npy),
            and frames.toml for what the files do not state: bits, exposure times, photons, eta.
        out: The TOML file.
        window: Side of the central square of the sensor that is used, in pixels.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed.calibration_frames import characterise_folder
    from sensor_model import write_sensor

    with _writing(out.parent, wait, name=f".{out.name}.lock"):
        sensor, found = characterise_folder(folder, window=window)
        write_sensor(out, sensor, comment=f"measured from {folder.resolve().name}; what the frames say:\n{found}")
    print(f"{found}\n{out}")
    _next(f"novags capture SET --sensor {out} --electrons 20 --out CAPTURE")


COMMANDS: dict[str, Callable[..., None]] = {
    function.__name__.rstrip("_"): function
    for function in (run, list_, plan, render, capture, reconstruct, score, report, characterise, doctor, help_)
}


def _variants(texts: tuple[str, ...]) -> "tuple[Variant, ...]":
    from novags.methods.variant import parse_variant, read_variants

    found = [read_variants(Path(text)) if text.endswith(".toml") else [parse_variant(text)] for text in texts]
    return tuple(variant for variants in found for variant in variants)


def _cameras(text: str | None) -> Any:
    from novags.cameras import parse_cameras

    return None if text is None else parse_cameras(text)


def _next(command: str) -> None:
    """Print the next command; on standard error, so that standard output holds only results."""
    print(f"next: {command}", file=sys.stderr)


def _console() -> "Console":
    """A console; from here on, termination is an interruption like Ctrl-C."""
    import pycolmap  # noqa: F401 - its crash handler would take SIGTERM over if it were imported later

    from novags.testbed.console import Console

    signal.signal(signal.SIGTERM, _terminated)
    return Console()


@contextmanager
def _writing(folder: Path, wait: bool, **lock: Any) -> "Iterator[Console]":
    """Hold a folder while a command writes there; `lock`: further arguments of `locked`."""
    from novags.testbed.folders.set import warnings_as_notes
    from sensor_model.files.lock import locked

    console = _console()
    with ExitStack() as held:
        with warnings_as_notes(console):
            held.enter_context(locked(folder, wait=console.note if wait else None, **lock))
        yield console


def _terminated(*_: object) -> NoReturn:
    raise KeyboardInterrupt


def _command_line() -> str:
    import shlex

    return shlex.join(["novags", *sys.argv[1:]])


def _announce(path: Path) -> None:
    print(f"report: {path.resolve()}")
    print(f"open it in a browser: {path.resolve().as_uri()}")
    _next("novags run --scene cornell, or novags list for what else is available")


def main() -> None:
    """Entry point: run a command."""
    if sys.argv[1:] == ["--version"]:
        from importlib.metadata import version

        print(f"novags {version('novags')}")
        return
    with errors_in_one_line():
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="novags", description=DESCRIPTION)


DESCRIPTION = "Test bed for low-light 3D reconstruction: rendered truth, dark captures, reconstructions, scores."
