"""The commands of single stages: plan, render, poses, capture, reconstruct."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from novags.commands import shared
from novags.commands.shared import cameras_of, next_, say, typed, variants_of, writing
from novags.options import LIGHT, Device, Folder, Light, Name, PresetName


def plan(
    scene: Name, *, sensor: str, electrons: float, time: float = 1 / 30, preset: PresetName = "demo",
    width: int | None = None, height: int | None = None, tolerance: float = 0.05, light_tolerance: float = 0.02,
    light: Light = LIGHT,
) -> None:  # fmt: skip
    """Show which effects would be simulated, which not, why, and the bound on the error of leaving them out.

    Args:
        scene: A multiview set folder, a scene of the catalogue, or a Mitsuba .xml or glTF file.
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
    from novags.numbers import check_range
    from novags.testbed.stages.configs.capturing import CaptureConfig
    from novags.testbed.stages.planning import PILOT, light_plan, sensor_plan
    from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

    check_range("light_tolerance", light_tolerance, 0, 1)
    config = CaptureConfig(sensor=sensor, electrons=electrons, time=time, tolerance=tolerance)
    size = adapted(EXPERIMENTS[preset], width=width, height=height).render
    pilot = replace(PILOT, scene=scene, **light.settings())
    # Blur is weighed in pixels and in steps between views: pixels of the real images, not of the pilot.
    views = replace(pilot, n_views=size.n_views, width=size.width, height=size.height)
    console = shared.console()
    found = light_plan(views, light_tolerance, console)
    say(f"Light of {scene}: {'given by the folder' if found is None else ''}\n{found or ''}".rstrip())
    noise, signal_e = sensor_plan(pilot, config, size.width * size.height, console, found)
    signal = ", ".join(f"{name} {value:.3g} e-" for name, value in signal_e.items())
    say(f"\nCamera {sensor}, mean green signal {electrons:g} e-; {signal}\n{noise}")


def render(
    scene: Name, *, out: Path, views: int = 32, width: int = 128, height: int = 128, spp: int | None = None,
    target_error: float | None = None, truth_samples: float = 8.0, denoise: bool = False, light: Light = LIGHT,
    export: tuple[Literal["blender", "llff"], ...] = (), seed: int = 0, overwrite: bool = False, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Render a scene into a ground-truth multiview set.

    Args:
        scene: A scene of the catalogue ("tabletop", or "tabletop:3" for its variation 3), or a Mitsuba .xml or glTF
            file.
        out: Folder of the set.
        views: Number of views.
        width: Image width in pixels.
        height: Image height in pixels.
        spp: Samples per pixel; 256 if neither this nor target_error is given.
        target_error: Relative error at which each view stops instead.
        truth_samples: Times these samples in held-out views, by which methods are judged; of a target error, a target
            smaller by the root of it.
        denoise: Smooth training views by Intel's denoiser, for previews; held-out views stay unbiased.
        light: How light gets from the lamps to the sensor.
        export: Further layouts of the set to write, each into a folder of its own in it.
        seed: Of the Monte Carlo noise.
        overwrite: Replace a finished result of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say whether it would be made, or made again and why. Nothing is written.
    """
    from novags.testbed import stages
    from novags.testbed.ledger.dry import dry_run as dry
    from novags.testbed.ledger.dry import planned
    from novags.testbed.stages.configs.rendering import RenderConfig
    from simscenes.job.accuracy import summary

    samples = 256 if spp is None and target_error is None else spp
    config = RenderConfig(
        scene=scene, n_views=views, width=width, height=height, spp=samples, target_error=target_error,
        truth_samples=truth_samples, denoise=denoise, export=export, seed=seed, **light.settings(),
    )  # fmt: skip
    with writing(out, wait, dry_run=dry_run) as console:
        with dry(dry_run):
            record = stages.render(out, config, console, overwrite=overwrite)
        planned(console, "export", [out / name for name in export])
        console.note(f"largest of all views: {summary(record['views'])}")
        say(out)
        next_(f"novags capture {typed(out)} --electrons 20 --out CAPTURE")


def poses(
    photographs: Folder, *, out: Path, fps: float | None = None, max_size: int | None = 1600, max_features: int = 4096,
    peak_threshold: float = 0.0067, pictures: Literal["auto", "raw", "enhanced", "denoised"] = "auto",
    mapper: Literal["auto", "incremental", "global"] = "auto", seed: int = 0, overwrite: bool = False,
    wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Find the unknown cameras of photographs, and make a multiview set of them.

    Args:
        photographs: A folder of photographs of one scene, or a video file.
        out: Folder of the set: undistorted pictures with their cameras.
        fps: Frames to take from each second of a video; 2 if not given.
        max_size: Scale larger photographs down to this longest side first, in pixels; None keeps them.
        max_features: Features in a picture, the largest ones.
        peak_threshold: Contrast of a feature, 0 to 1; lower it for soft photographs.
        pictures: In which features are looked for; auto: denoised if the photographs are dark, else raw.
        mapper: Grow from one pair, or solve for all cameras at once; auto: global with denoised pictures.
        seed: Of the robust estimates.
        overwrite: Replace a finished result of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say whether it would be made, or made again and why. Nothing is written.
    """
    from novags.testbed import stages
    from novags.testbed.stages.configs.posing import PosesConfig

    config = PosesConfig(
        photographs=photographs, fps=fps, max_size=max_size, max_features=max_features, peak_threshold=peak_threshold,
        pictures=pictures, mapper=mapper, seed=seed,
    )  # fmt: skip
    with writing(out, wait, dry_run=dry_run) as console:
        record = stages.poses(out, config, console, overwrite=overwrite)
        say(out)
        light = f"novags capture {typed(out)} --electrons 20 --out CAPTURE, or novags run --scene {typed(out)}"
        next_(f"novags import {typed(out)} --out CAPTURE" if record.get("dark") else light)


def capture(
    set: Folder, *, out: Path, level: str | None = None, sensor: str | None = None, electrons: float | None = None,
    time: float = 1 / 30,
    max_size: int | None = None, demosaic: Literal["menon", "malvar", "bilinear"] = "menon",
    jpeg_quality: int | None = None, tolerance: float | None = 0.05, dark_frames: Path | None = None, burst: int = 1,
    exposure_spread: float = 0.0, white_balance_spread: float = 0.0, bracket: float = 0.0,
    export: tuple[Literal["blender", "llff"], ...] = (), seed: int = 0, overwrite: bool = False, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Photograph a multiview set in the dark: a rendered one, or real posed photographs.

    Args:
        set: A set folder, a nerfstudio, instant-ngp or NeRF-synthetic folder (transforms*.json with 8-bit images,
            camera raw files or linear EXR), a COLMAP folder (sparse/0, images) or an LLFF folder (poses_bounds.npy,
            images).
        out: Folder of the capture.
        level: Camera and electrons of one of the paper's data sets; `novags list levels` shows them. The pictures of
            one of 16 bits are chosen later: `novags reconstruct --pictures 16bit`.
        sensor: A camera of sensor_model.PRESETS, or a TOML file of your own; if not given, the level's, else
            a7s2-iso6400-3chip.
        electrons: Mean signal of the green channel over the set, electrons per pixel and exposure; if not given, the
            level's, else 20.
        time: Exposure time in seconds; only the dark current depends on it.
        max_size: Scale larger images down to this longest side, in pixels.
        demosaic: Interpolation of the colour filter array.
        jpeg_quality: 1 to 100: put the 8-bit pictures through JPEG.
        tolerance: Leave out effects that change the noise by less than this share; None simulates all.
        dark_frames: Folder of dark frames of this camera (raw files, 16-bit PNG or TIFF, npy), or of isoN/ folders of
            them: each view draws one, in place of read noise, rows, banding, dark current, offsets and hot pixels.
        burst: Frames of each view, whose mean is its picture.
        exposure_spread: Stops by which the exposure time of a view differs at most, as an automatic exposure would.
        white_balance_spread: Mired by which the white balance of a view's pictures errs at most; its raw file has none.
        bracket: Stops by which every second view is exposed longer.
        export: Further layouts of the capture to write, each into a folder of its own in it.
        seed: Of the noise.
        overwrite: Replace a finished result of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say whether it would be made, or made again and why. Nothing is written.
    """
    from novags.testbed import stages
    from novags.testbed.ledger.dry import dry_run as dry
    from novags.testbed.ledger.dry import planned
    from novags.testbed.stages.configs.capturing import CaptureConfig
    from novags.testbed.study.cells.levels import LightLevel, level_named

    named = CaptureConfig() if level is None else level_named(level)
    config = CaptureConfig(
        sensor=named.sensor if sensor is None else sensor,
        electrons=named.electrons if electrons is None else electrons, time=time, max_size=max_size, demosaic=demosaic,
        jpeg_quality=jpeg_quality, tolerance=tolerance, dark_frames=dark_frames, burst=burst,
        exposure_spread=exposure_spread, white_balance_spread=white_balance_spread, bracket=bracket, export=export,
        seed=seed,
    )  # fmt: skip
    with writing(out, wait, dry_run=dry_run) as console:
        with dry(dry_run):
            stages.capture(set, out, config, console, overwrite=overwrite)
        planned(console, "export", [out / name for name in export])
        say(out)
        pictures = " --pictures 16bit" if isinstance(named, LightLevel) and named.pictures == "16bit" else ""
        next_(f"novags reconstruct {typed(out)} --method nova-fast{pictures} --out RUN")


def reconstruct(
    capture: Folder, *, out: Path, method: str | None = None, variant: str | None = None, preset: PresetName = "demo",
    pictures: Literal["8bit", "16bit"] | None = None, cameras: str | None = None, refine_cameras: bool = False,
    points: int | None = None, iterations: int | None = None, denoiser_steps: int | None = None,
    score_at: tuple[int, ...] = (), hold_out: int | None = None, seed: int = 0, device: Device = "auto",
    export: tuple[Literal["3dgs", "splat", "spz", "spz2"], ...] = (),
    log: Literal["tensorboard", "wandb", "rerun"] | None = None, overwrite: bool = False, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Reconstruct a capture with one method: a 3D model, and pictures rendered from it.

    Args:
        capture: Folder of the capture.
        out: Folder of the run.
        method: A method or variant; `novags list methods` names them; nova-fast if neither this nor a variant is given.
        variant: A method with settings changed, NAME=METHOD:SETTING=VALUE,SETTING=VALUE. Or a TOML file with tables
            [variant.NAME], of which --method names one.
        preset: Source of every setting of the method that is not given here.
        pictures: Which pictures the method sees: 8-bit sRGB, or 16-bit linear ones; its own choice if not given.
        cameras: Where cameras come from: known, known:rotation_deg=1, sfm, dust3r:checkpoint=FILE; see `novags help
            cameras`.
        refine_cameras: Let a fit of Gaussians correct its training cameras. Radiance fields, and averaging, take them
            as given.
        points: Gaussians at the start.
        iterations: Of the fit.
        denoiser_steps: Of the denoiser before the fit starts.
        score_at: Iterations after which held-out views are shown and scored, along one fit, which stays the same.
        hold_out: Training views, drawn by the seed, that nothing is trained on. With --score-at, every fit then has a
            stop of its own, which sees no truth: the length that shows their dark pictures best.
        seed: Of training.
        device: Where training runs; auto takes a GPU if there is one that can be used.
        export: Formats of viewers to write into RUN/viewers: a .ply of degree 3 with cameras.json, .splat, .spz
            (spz2: of version 2, which is all that some readers know).
        log: Send the losses to a logger as they are written; its files lie in OUT.logs.
        overwrite: Replace a finished result of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say whether it would be made, or made again and why. Nothing is written.
    """
    from novags.testbed import stages
    from novags.testbed.ledger.dry import dry_run as dry
    from novags.testbed.ledger.dry import planned
    from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

    own = variants_of(() if variant is None else (variant,))
    name = _one_of([each.name for each in own], method)
    chosen = adapted(
        EXPERIMENTS[preset], methods=(name,), variants=own, cameras=cameras_of(cameras), refine_cameras=refine_cameras,
        points=points, iterations=iterations, denoiser_steps=denoiser_steps, score_at=score_at or None,
        hold_out=hold_out, pictures=pictures, device=device,
    )  # fmt: skip
    config = replace(chosen.reconstruct(name), seed=seed)
    from novags.testbed.loggers.following import logged
    from novags.testbed.stages.viewers import check_viewers, viewer_files, write_viewers

    with writing(out, wait, dry_run=dry_run) as console:
        with dry(dry_run) as kept:
            with logged(out, None if dry_run else log, console):
                stages.reconstruct(capture, out, config, console, overwrite=overwrite)
        if kept != [False]:  # whether a run that is not there yet will hold Gaussians is seen then
            check_viewers(out, export)
        planned(console, "viewers", viewer_files(out, export))
        if other := write_viewers(out, export):
            console.warn(other)
        say(out)
        next_(f"novags score {typed(out)} && novags report {typed(out)}")


def _one_of(variants: list[str], method: str | None) -> str:
    """The method or variant to run, from `--method` and `--variant`; refused if they disagree or leave it open."""
    if method is None and len(variants) <= 1:
        return variants[0] if variants else "nova-fast"
    if variants and method not in variants:
        problem = "more than one" if method is None else f"but --method is {method}"
        raise ValueError(f"--variant defines {', '.join(variants)}, {problem}: name one of them with --method")
    return str(method)
