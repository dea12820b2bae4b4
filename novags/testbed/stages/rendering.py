"""Render: a scene of the catalogue or a Mitsuba file in, a ground-truth multiview set out."""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from novags.numbers import PIXELS, SAMPLES, SIDE, VIEWS, check_range
from novags.settings import check_seed
from novags.testbed.cache import run_stage
from novags.testbed.console import Console
from novags.testbed.contents import digest, read_json
from novags.testbed.folders.set import warnings_as_notes
from novags.testbed.stages.layouts import LAYOUTS, check_cameras_of, check_layouts, write_layouts
from sensor_model.files.door import read_bytes
from sensor_model.files.lock import locked
from sensor_model.files.reading import brief
from sensor_model.plan import Plan
from simscenes.backend import BACKENDS, COLORS, choose_variant
from simscenes.camera import camera_color
from simscenes.job.identity import SPENT
from simscenes.loading.checks.untrusted import check_xml
from simscenes.loading.reference import SceneRef
from simscenes.optics import Optics
from simscenes.rigs import Rig
from simscenes.sets.writers.camera_files import CAMERA_FILES
from simscenes.sets.writers.neighbours import DEPTHS
from simscenes.transport.plan import EFFECTS

RECORD = "set.json"
SET_FILES = (RECORD, "gt", "images", DEPTHS, SPENT, *CAMERA_FILES, *LAYOUTS)  # of a set folder made here, of any kind
VARIANTS = ("auto", *BACKENDS, *(f"{backend}_{color}" for backend in BACKENDS for color in COLORS))


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """What to render and how well."""

    scene: str = "tabletop"  # a name of simscenes.SCENES, "tabletop:3" for its variation 3, or a Mitsuba .xml file
    n_views: int = 32
    width: int = 128  # px
    height: int = 128  # px
    spp: int | None = 256  # samples per pixel; None: as many as `target_error` requires
    target_error: float | None = None  # relative RMSE of a view
    variant: str = "auto"  # of Mitsuba
    on: tuple[str, ...] = ()  # effects of light that are simulated whatever the plan says
    off: tuple[str, ...] = ()  # and that are left out
    max_depth: int | None = None  # longest path of light, as Mitsuba counts; None: as long as the plan finds worthwhile
    optics: Optics = field(default_factory=Optics)  # lens (None: a file's own, else a pinhole), motion, colour filters
    allow_outside: bool = False  # let a Mitsuba file read files outside its folder
    parameters: tuple[str, ...] = ()  # "name=value": what the $names of a Mitsuba file stand for
    sensor_index: int = 0  # which of a Mitsuba file's sensors the cameras are placed around, from 0
    own_cameras: bool = False  # all of a Mitsuba file's sensors are the views; their number is not n_views then
    export: tuple[str, ...] = ()  # further layouts of the set: "blender", "llff"
    seed: int = 0

    def __post_init__(self) -> None:
        # The blocks of the enhancement and SSIM's window need room, and every 8th view is held out.
        if min(self.width, self.height) < 16:
            raise ValueError(f"width and height must be >= 16 px, got {self.width} x {self.height}")
        if self.n_views < 3:
            raise ValueError(f"n_views must be >= 3 (one is held out, two are trained on), got {self.n_views}")
        if (self.spp is None) == (self.target_error is None):
            raise ValueError(f"give either spp or target_error, got {self.spp} and {self.target_error}")
        if self.spp is not None and self.spp < 2:
            raise ValueError(f"spp must be >= 2, because the variance needs two halves, got {self.spp}")
        if self.target_error is not None and not 0 < self.target_error < 1:
            raise ValueError(f"target_error must lie in (0, 1), got {self.target_error}")
        check_range("n_views", self.n_views, 3, VIEWS)
        check_range("width", self.width, 16, SIDE, " px")
        check_range("height", self.height, 16, SIDE, " px")
        check_range("width x height", self.width * self.height, 256, PIXELS, " px")
        if self.spp is not None:
            check_range("spp", self.spp, 2, SAMPLES)
        if self.max_depth is not None:
            check_range("max_depth", self.max_depth, 1, SAMPLES)
        check_range("sensor_index", self.sensor_index, 0, VIEWS)
        check_seed(self.seed)
        if not os.path.isdir(self.scene):  # a set that is there already; pathlib fails at long names
            _ = self.source  # refuses a scene that there is not
        for what, given, known in (
            ("variant", (self.variant,), VARIANTS),
            ("on and off", (*self.on, *self.off), EFFECTS),
        ):
            if unknown := [name for name in given if name not in known]:
                raise ValueError(f"{what} must be among {', '.join(known)}; got {brief(', '.join(unknown))}")
        check_layouts(self.export)
        if both := set(self.on) & set(self.off):
            raise ValueError(f"{brief(', '.join(sorted(both)))}: forced on and off at once; name each effect once")

    def resolved(self) -> dict[str, Any]:
        """What determines the pixels, apart from the content of the scene: neither its path nor further layouts."""
        kept = {name: value for name, value in asdict(self).items() if name != "export"}
        for name in ("parameters", "sensor_index", "own_cameras"):
            if not kept[name]:
                del kept[name]  # sets rendered before these options existed stay valid
        return kept | {"scene": self.source.name}

    @property
    def source(self) -> SceneRef:
        """The scene of the catalogue, or the Mitsuba file.

        Raises:
            ValueError: If no scene of the catalogue has that name, or it cannot have the parameters or the sensor.
        """
        return SceneRef.of(self.scene).given(self.parameters, self.sensor_index)


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
            inputs={"scene": scene_digest(config)},
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
    """What the scene is: the name of a catalogue scene, or a hash of a file and of the files that it names.

    Raises:
        ValueError: If the name is unknown, or the file cannot be read or must not be trusted.
    """
    source = config.source
    if source.path is None:
        return source.name
    files = check_xml(source.path, allow_outside=config.allow_outside, parameters=source.parameters)
    return digest([hashlib.blake2b(read_bytes(named)).hexdigest() for named in files if named.is_file()])


def prepare_render(config: RenderConfig, console: Console) -> tuple[Rig, Plan | str]:
    """The cameras, and what the plan has to be ("auto" where no effect is forced).

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


def render_views(out: Path, config: RenderConfig, rig: Rig, plan: Plan | str, console: Console) -> dict[str, Any]:
    """Render every view that is not there yet; returns the body of set.json.

    Raises:
        ValueError: If the scene cannot be rendered.
    """
    from simscenes.job.render_set import render_set

    with console.progress("render") as progress, warnings_as_notes(console):
        render_set(
            config.source, rig, out, spp=config.spp, target_error=config.target_error, plan=plan,
            optics=config.optics, variant=config.variant, seed=config.seed, allow_outside=config.allow_outside,
            progress=progress,
        )  # fmt: skip
    return read_json(out / RECORD)


def plan_of(config: RenderConfig, tolerance: float = 0.02) -> Plan:
    """The plan of the light transport, with what the configuration forces.

    Args:
        config: Scene, cameras and forced effects.
        tolerance: Share of all light that may be wrong or missing.

    Raises:
        ValueError: If no plan can be made for the scene.
    """
    from simscenes.transport import plan_transport

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
