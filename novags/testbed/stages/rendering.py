"""Render: a scene of the catalogue or a Mitsuba file in, a ground-truth multiview set out."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console, warnings_as_notes
from novags.testbed.ledger.contents import digest, read_json
from novags.testbed.ledger.stage import run_stage
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.layouts import RECORD, SET_FILES, check_cameras_of, write_layouts
from sensor_model.files.door import read_bytes
from sensor_model.files.lock import locked
from sensor_model.plan import Plan
from simscenes.backend import choose_variant
from simscenes.camera import camera_color
from simscenes.loading.load import scene_files
from simscenes.rigs import Rig


def render(
    out: Path, config: RenderConfig, console: Console, *, stale: Sequence[Path] = (), overwrite: bool = False
) -> dict[str, Any]:
    """Render a scene into the set folder `out`; returns set.json.

    Raises:
        ValueError: If the scene is unknown or cannot be rendered, or `out` holds other things or, unless `overwrite`, a
            finished result of another request.
        BlockingIOError: If another process is writing to `out`.
    """
    with locked(out):
        record = run_stage(
            "render",
            out,
            RECORD,
            code=config.code,
            inputs=lambda: {"scene": scene_digest(config)},
            config=config.resolved(),
            owns=SET_FILES,
            prepare=lambda: prepare_render(config, console),
            work=lambda prepared: render_views(out, config, *prepared, console),
            console=console,
            stale=stale,
            overwrite=overwrite,
        )
        write_layouts(out, config.export, console)
        return record


def scene_digest(config: RenderConfig) -> str:
    """The identity of the scene: the name of a catalogue scene, or a hash of a file and of the files that it names.

    Raises:
        ValueError: If the name is unknown, or the file cannot be read or must not be trusted.
    """
    source = config.source
    if source.path is None:
        return source.name
    files = scene_files(source, config.allow_outside)
    return digest([hashlib.blake2b(read_bytes(named)).hexdigest() for named in files if named.is_file()])


def prepare_render(config: RenderConfig, console: Console) -> tuple[Rig, Plan | str]:
    """The cameras, and the required plan ("auto" where no effect is forced).

    Raises:
        ValueError: If the scene, the variant or the camera is unknown, or cannot be loaded or used on this machine, or
            a further layout cannot hold the cameras.
    """
    with warnings_as_notes(console):
        choose_variant(config.variant)
        if config.optics.camera is not None:
            camera_color(config.optics.camera)
        decided = bool(config.on or config.off or config.max_depth is not None)
        rig = rig_of(config)
        check_cameras_of(config.export, rig)
        return rig, plan_of(config) if decided else "auto"


def render_views(
    out: Path, config: RenderConfig, rig: Rig, plan: Plan | str, console: Console, *, sketch: bool = False
) -> dict[str, Any]:
    """Render every view that is not there yet; returns the body of set.json. A sketch says no errors.

    Raises:
        ValueError: If the scene cannot be rendered.
    """
    from simscenes.job.render_set import render_set

    with console.progress("sketch" if sketch else "render") as shown, warnings_as_notes(console):
        progress = (lambda done, of, text: shown(done, of, text if done < of else "")) if sketch else shown
        render_set(
            config.source, rig, out, spp=config.spp, target_error=config.target_error,
            truth_samples=config.truth_samples, denoise=config.denoise, plan=plan, optics=config.optics,
            variant=config.variant, seed=config.seed, allow_outside=config.allow_outside, progress=progress,
        )  # fmt: skip
    return read_json(out / RECORD)


def plan_of(config: RenderConfig, tolerance: float = 0.02) -> Plan:
    """The plan of the light transport, with the effects that the configuration forces.

    Args:
        config: Scene, cameras and forced effects.
        tolerance: Share of all light that may be wrong or missing.

    Raises:
        ValueError: If no plan can be made for the scene.
    """
    from simscenes.transport.planner import plan_transport

    return plan_transport(
        config.source, tolerance, rig=rig_of(config), optics=config.optics, variant=config.variant,
        max_depth=config.max_depth, seed=config.seed,
        force=dict.fromkeys(config.on, True) | dict.fromkeys(config.off, False), allow_outside=config.allow_outside,
    )  # fmt: skip


def rig_of(config: RenderConfig) -> Rig:
    """The cameras: those designed for a catalogue scene, or an arc around a file's own camera.

    Raises:
        ValueError: If the scene is unknown, cannot be loaded, or has no camera to start from.
    """
    from simscenes.render.fitting import fit_rig
    from simscenes.render.framing import own_cameras
    from simscenes.scenes import default_rig

    source, size = config.source, (config.width, config.height)
    if source.in_catalogue:
        if config.own_cameras:
            raise ValueError(f"scene {config.scene!r} is of the catalogue: it has no cameras of its own to use")
        return default_rig(config.scene, config.n_views, *size)
    if not config.own_cameras:
        return fit_rig(source, config.n_views, *size, allow_outside=config.allow_outside)
    own_lenses = config.optics.aperture_radius is None
    rig = own_cameras(source, *size, own_lenses=own_lenses, allow_outside=config.allow_outside)
    if len(rig) < 3:
        raise ValueError(f"scene {config.scene} has {len(rig)} sensors: its own cameras must be 3 or more (one is held "
                         "out, two are trained on); leave own_cameras out for cameras around one of them")  # fmt: skip
    return rig
