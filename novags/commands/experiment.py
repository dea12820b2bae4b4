"""`novags run`: a whole comparison."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from novags.commands.shared import (
    ELSE,
    announce,
    cameras_of,
    command_line,
    say,
    say_ranking,
    typed,
    variants_of,
    writing,
)
from novags.commands.study import check_numbers, engine_of
from novags.options import CLUSTER, Cluster, Define, Device, PresetName, Repeated

if TYPE_CHECKING:
    from novags.testbed.console.terminal import Console
    from novags.testbed.study.cells.presets import Preset


def run(
    *,
    preset: PresetName = "demo",
    scene: str | None = None,
    photos: Path | None = None,
    fps: float | None = None,
    define: Define = (),
    level: str | None = None,
    sensor: str | None = None,
    electrons: float | None = None,
    dark_frames: Path | None = None,
    budget: str | None = None,
    curves: Path | None = None,
    out: Path | None = None,
    methods: tuple[str, ...] | None = None,
    variant: Repeated = (),
    cameras: str | None = None,
    refine_cameras: bool = False,
    views: int | None = None,
    width: int | None = None,
    height: int | None = None,
    spp: int | None = None,
    max_size: int | None = None,
    points: int | None = None,
    iterations: int | None = None,
    denoiser_steps: int | None = None,
    score_at: tuple[int, ...] = (),
    hold_out: int | None = None,
    seed: int | None = None,
    device: Device = "auto",
    engine: Literal["local", "ray"] = "local",
    workers: int | None = None,
    cluster: Cluster = CLUSTER,
    log: Literal["tensorboard", "wandb", "rerun"] | None = None,
    overwrite: bool = False,
    wait: bool = False,
    dry_run: bool = False,
) -> None:
    """Run a whole experiment: render, capture in the dark, reconstruct with several methods, score, report.

    Finished work is kept: the same command again does only the rest.

    Args:
        preset: Source of every setting that is not given here.
        scene: A scene of the catalogue ("tabletop", or "tabletop:3" for its variation 3), a Mitsuba .xml or glTF file,
            or a set folder: one of novags, nerfstudio, instant-ngp, NeRF-synthetic, COLMAP or LLFF.
        photos: Instead of a scene: a folder of photographs without poses, or a video file; the poses are found first.
        fps: Frames to take from each second of the video; 2 if not given.
        define: The value of a parameter of a Mitsuba file, NAME=VALUE; may be given several times.
        level: Camera, electrons and pictures of one of the paper's data sets: lom, llnerf, llrs or mvtv, with -3chip
            without demosaicing; `novags list levels` shows them. --sensor and --electrons change it.
        sensor: A camera of sensor_model.PRESETS, or a TOML file of your own.
        dark_frames: As of `novags capture`.
        electrons: Mean signal of the green channel over the set, electrons per pixel and exposure.
        budget: Time that everything may take, 120s, 5min, 1h: iterations, Gaussians, denoiser steps, samples and size
            are chosen to lose least against the preset, except the settings given here. The expected loss is said
            before, from curves that `novags pareto` measures.
        curves: With a budget: folder of the curves of `novags pareto METHOD`; if not given, the curves of this machine
            in out/pareto, for other methods the curves that came with novags.
        out: Folder of the experiment; if not given, out/PRESET, with scene, electrons and budget where they are given.
        methods: Methods and variants to compare; `novags list methods` names them. NAME*3 is the mean of three fits.
        variant: A method with settings changed, NAME=METHOD:SETTING=VALUE,SETTING=VALUE, compared as well; may be given
            several times. Or a TOML file with tables [variant.NAME], of which --methods may name some.
        cameras: Where cameras come from: known, known:rotation_deg=1, sfm, dust3r:checkpoint=FILE; see `novags help
            cameras`.
        refine_cameras: Let every fit of Gaussians correct its training cameras. Radiance fields, and averaging, take
            them as given.
        views: Number of views.
        width: Image width in pixels.
        height: Image height in pixels.
        spp: Samples per pixel of the render.
        max_size: Scale larger images down to this longest side, in pixels; for photographs the preset's size if not
            given.
        points: Gaussians at the start.
        iterations: Of the fit.
        denoiser_steps: Of the denoiser before the fit starts.
        score_at: Iterations after which held-out views are shown and scored, along each fit of Gaussians, which stays
            the same.
        hold_out: Training views, drawn by the seed, that nothing is trained on. With --score-at, every fit then has a
            stop of its own, which sees no truth: the length that shows their dark pictures best.
        seed: Of noise and training.
        device: Where training runs; auto takes a GPU if there is one that can be used.
        engine: Where the work is done: on this machine, or on a Ray cluster.
        workers: Methods at a time, each in a process of its own, among which all cores are divided; if not given, one
            after another with all cores.
        cluster: Of --engine ray.
        log: Send the losses of every fit to a logger as they are written; its files lie in OUT.logs.
        overwrite: Replace finished results of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which stages would be done, or done again and why. Nothing is written. With a budget whose
            settings are not chosen yet: the trial to do, and the settings to choose from.
    """
    from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

    check_numbers(workers, cluster)
    side_by_side = engine == "ray" or workers is not None or cluster != CLUSTER
    if budget is not None and side_by_side:
        raise ValueError("a budget predicts the time of one method after another: leave out --budget, or --workers and "
                         "--engine")  # fmt: skip
    chosen = adapted(
        EXPERIMENTS[preset], scene=scene, photos=photos, fps=fps, level=level, sensor=sensor, electrons=electrons,
        dark_frames=dark_frames,
        methods=_compared(methods, variant), n_views=views,
        width=width, height=height, spp=spp, max_size=max_size, points=points, iterations=iterations,
        denoiser_steps=denoiser_steps, score_at=score_at or None, hold_out=hold_out, seed=seed,
        variants=variants_of(variant), cameras=cameras_of(cameras), refine_cameras=refine_cameras, device=device,
        parameters=define or None,
    )  # fmt: skip
    from novags.testbed.loggers.following import logged
    from novags.testbed.report.verdict import limits_so_far
    from novags.testbed.study import place

    if log is not None and budget is not None:
        raise ValueError(f"--log {log} does not go with a budget, whose trials are not logged: leave one of them out")
    whole = Path("out") / _default_name(preset, scene if photos is None else str(photos), level, electrons)
    if budget is None:
        if curves is not None:
            raise ValueError(f"--curves {curves} belong to a budget: add --budget, or leave them out")
        folder = whole if out is None else out
        where = engine_of(engine, len(chosen.methods), workers, cluster, None) if side_by_side else None
        with writing(folder, wait, dry_run=dry_run) as console:
            if dry_run:
                place.said(chosen, folder, console, overwrite=overwrite)
                return
            with logged(folder, log, console):
                page = place.run(chosen, folder, console, report=_reported, doubt=limits_so_far,
                                 engine=where, command=command_line(folder), overwrite=overwrite)  # fmt: skip
        _conclude(page, folder)
        return
    decided = {
        "iterations": iterations, "points": points, "denoiser_steps": denoiser_steps, "spp": spp,
        "size": width or height,
    }  # fmt: skip
    given = frozenset(name for name, value in decided.items() if value is not None)
    _within(chosen, budget, given, curves, out, whole, wait, overwrite, dry_run)


def _compared(methods: tuple[str, ...] | None, variant: Repeated) -> tuple[str, ...] | None:
    """The methods of `--methods` and the variants that are spelled out; from a file of variants `--methods` chooses."""
    spelled = variants_of(tuple(text for text in variant if not text.endswith(".toml")))
    return methods and (*methods, *(each.name for each in spelled if each.name not in methods))


def _within(
    preset: "Preset", budget: str, given: frozenset[str], curves: Path | None, out: Path | None, whole: Path,
    wait: bool, overwrite: bool, dry_run: bool,
) -> None:  # fmt: skip
    """Run an experiment in a given time; `whole`: where the same one without a budget lies, if it was run."""
    from novags.testbed.ledger.dry import NOT_DONE, planned
    from novags.testbed.report.verdict import limits_so_far
    from novags.testbed.study import place
    from novags.testbed.study.budget.duration import seconds_of
    from novags.testbed.study.budget.said import after
    from novags.testbed.study.budget.within import RECORD, Request, told, within

    request = Request(preset, seconds_of(budget), given, curves)
    folder = whole.with_name(f"{whole.name}-{request.budget:g}s") if out is None else out
    with writing(folder, wait, dry_run=dry_run) as console:
        place.refuse_impossible(preset)
        if dry_run:
            chosen, lines = told(request, folder, console, overwrite=overwrite)
            for line in lines:
                console.note(line if chosen else f"{line} {NOT_DONE}")
            if chosen is None:
                planned(console, "budget", [folder / RECORD])
            else:
                place.said(chosen, folder, console, overwrite=overwrite)
            return
        with within(request, folder, console, place.run, overwrite=overwrite) as under_way:
            place.photograph(under_way.preset, folder, console, overwrite=overwrite)
            under_way.adjust()
            page = place.run(under_way.preset, folder, console, report=_reported, doubt=limits_so_far,
                             command=command_line(folder), overwrite=overwrite)  # fmt: skip
        for line in after(preset, folder, under_way.state, whole):
            say(line)
        _conclude(page, folder)


def _reported(folder: Path, console: "Console") -> Path:
    """Write the report, and say how it begins."""
    from novags.testbed.report.page import write_report

    page = write_report(folder, console)
    say_ranking(folder)
    return page


def _conclude(page: Path, folder: Path) -> None:
    announce(page, f"novags view {typed(folder)}, to look at it in 3D; or {ELSE}")


def _default_name(preset: str, source: str | None, level: str | None, electrons: float | None) -> str:
    """Name of an experiment's folder: different scenes and light do not share one."""
    from simscenes.sets.names import safe_name

    parts = [preset]
    if source is not None:
        path = Path(os.path.realpath(source))
        parts.append(safe_name(path.name if path.is_dir() else path.stem))  # a folder's name has no suffix
    parts += [] if level is None else [level]
    return "-".join([*parts, *([] if electrons is None else [f"{electrons:g}e"])])
