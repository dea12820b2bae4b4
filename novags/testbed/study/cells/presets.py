"""Presets: whole experiments by name, from a demonstration to the paper's own settings."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from novags.cameras.source import CameraConfig
from novags.cameras.sources.known import KnownConfig
from novags.methods import METHODS, chosen, with_variants
from novags.methods.enhancers import refuse_without_weights
from novags.methods.inputs import LacksInput
from novags.methods.variant import Variant, read_variants, spelled_out
from novags.settings import changed, files_among, has_setting, refuse_lost, refuse_lost_files, starting_at
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.study.cells.levels import level_named
from sensor_model.files.door import resolved
from simscenes.sets.multiview import is_rendered

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Config = TypeVar("Config", bound="DataclassInstance")


@dataclass(frozen=True, kw_only=True)
class Preset:
    """An experiment: the scene to render, how to photograph it, which methods with which settings."""

    render: RenderConfig
    folder: Path | None = None  # a set folder to photograph instead of a render
    photos: PosesConfig | None = None  # or photographs, of which a set is made first
    dark: Path | None = None  # or dark photographs, of a study: imported unchanged, nothing is captured
    imported: ImportConfig = field(default_factory=ImportConfig)  # how
    capture: CaptureConfig
    methods: tuple[str, ...]  # names of methods or variants
    variants: tuple[Variant, ...] = ()  # of this experiment alone
    commands: tuple[CommandConfig, ...] = ()  # methods that are programs, of a study
    points: int  # Gaussians at the start
    settings: Mapping[str, Any] = field(default_factory=dict)  # for every method that has them, by dotted name
    cameras: CameraConfig = field(default_factory=KnownConfig)
    hold_out: int = 0  # training views that no method of the test bed sees
    device: str = "auto"

    def __post_init__(self) -> None:
        object.__setattr__(self, "methods", tuple(map(spelled_out, self.methods)))
        if not self.methods or len(set(self.methods)) < len(self.methods):
            raise ValueError(f"methods must be named once each, got {', '.join(self.methods) or 'none'}")
        own = [name for name in self.methods if self.command(name) is None]
        configs = [self.reconstruct(name).config for name in own]  # which checks the rest
        for name in own:
            refuse_lost(_files(self._recipe(name)), name)
        for key in self.settings:
            published = any(_published(method.config, key) for method in METHODS.values())
            if not published and not any(has_setting(config, key) for config in configs):
                raise ValueError(f"no method has a setting {key!r}")

    def command(self, name: str) -> CommandConfig | None:
        """The program that is the method of this name; None if it is one of the test bed."""
        found = next((command for command in self.commands if command.name == name), None)
        return None if found is None else replace(found, seed=self.capture.seed)

    def reconstruct(self, name: str) -> ReconstructConfig:
        """How the experiment reconstructs by one of its methods or variants."""
        recipe = self._recipe(name)
        return ReconstructConfig(
            variant=recipe.variant, config=_configured(recipe), cameras=self.cameras, points=self.points,
            seed=self.capture.seed, hold_out=self.hold_out, device=self.device,
        )  # fmt: skip

    def refuse_lacking(self) -> None:
        """Refuse methods that lack data which none of the stages before them can give: said before any work.

        Raises:
            LacksInput: If there is one.
        """
        photographs = self.photos or self.dark or (self.folder is not None and not is_rendered(self.folder))
        for name in self.methods:
            if self.command(name) is not None:
                continue
            config = self.reconstruct(name)
            refuse_without_weights(config.config, name)
            if photographs and METHODS[config.variant.method].sees_surface:
                raise LacksInput(f"{name} follows the true surface, which is not known of photographs: leave it out")

    def _recipe(self, name: str) -> "_Recipe":
        return _Recipe.of(chosen(name, with_variants(self.variants)), self.settings)


@cache
def _published(make: Callable[[], Any], key: str) -> bool:
    """Whether the configuration of a method, as published, has a setting."""
    return has_setting(make(), key)


@dataclass(frozen=True)
class _Recipe:
    """The parts of a method's configuration; equal if all parts are, types of numbers included."""

    text: str
    make: Callable[[], Any]
    variant: Variant = field(compare=False)
    settings: Mapping[str, Any] = field(compare=False)

    @staticmethod
    def of(variant: Variant, settings: Mapping[str, Any]) -> "_Recipe":
        return _Recipe(repr((variant, dict(settings))), METHODS[variant.method].config, variant, settings)


@lru_cache(maxsize=1024)
def _configured(recipe: _Recipe) -> Any:
    """A configuration, which is frozen: the runs of a study are many, and differ in few."""
    return recipe.variant.config(recipe.make(), recipe.settings)


@lru_cache(maxsize=1024)
def _files(recipe: _Recipe) -> dict[str, tuple[Path, ...]]:
    return files_among(_configured(recipe))


# A size that a CPU handles in minutes. Short runs want large first Gaussians, which close the surface at once, and
# rates that fall to their end within the run. Small pictures want splats that are dilated less (docs/splat-engine.md).
_SHORT: dict[str, Any] = {
    "init_scale": 0.7,
    "fit.eps2d": 0.1,
    "fit.rates.schedule": "gsplat",
    "fit.mcmc.refine_stop": None,
    "fit.checkpoint_every": 250,
    "denoiser.warmup_steps": 128,
}

# The paper's settings where it states them, the defaults of 3DGS-MCMC where it does not.
_PAPER = Preset(
    render=RenderConfig(scene="tabletop", n_views=128, width=800, height=800, spp=1024, truth_samples=1),
    capture=CaptureConfig(sensor="a7s2-iso6400", electrons=20.0),
    methods=("nova", "naive", "naive-l1", "oracle"),
    points=100_000,
    settings={"fit.cap_max": 1_000_000, "fit.checkpoint_every": 250},
)

# Noise of the truth makes 14 % of the oracle's squared error at the demo's 96 samples, and falls as one over samples:
# `truth_samples` keeps it below 2 %.
EXPERIMENTS = {
    "demo": Preset(
        render=RenderConfig(scene="tabletop", n_views=20, width=160, height=160, spp=96),
        capture=CaptureConfig(sensor="a7s2-iso6400-3chip", electrons=20.0),
        methods=("nova-fast", "naive", "naive-l1", "nova-plus", "oracle"),
        points=20_000,
        settings={
            **_SHORT,
            "fit.iterations": 2400,
            "fit.sh_degree": 1,
            "fit.sh_every": 400,
            "fit.mcmc.refine_start": 100,
        },
    ),
    "small": Preset(
        render=RenderConfig(scene="tabletop", n_views=64, width=256, height=256, spp=256, truth_samples=3),
        capture=CaptureConfig(sensor="a7s2-iso6400-3chip", electrons=20.0),
        methods=("nova-fast", "naive", "naive-l1", "oracle"),
        points=30_000,
        settings={**_SHORT, "fit.iterations": 3000, "fit.sh_degree": 2, "fit.sh_every": 500},
    ),
    "paper": _PAPER,
    # The same on pictures that a CPU can pay: no other setting differs.
    "paper-160": replace(
        _PAPER,
        render=replace(_PAPER.render, n_views=20, width=160, height=160),
        points=20_000,
        settings={**_PAPER.settings, "fit.cap_max": 20_000},
    ),
}


def variants_in(path: Path) -> tuple[Variant, ...]:
    """The variants of a TOML file; files among their settings start at its folder.

    Raises:
        ValueError: As `read_variants`; or if a method, a setting or a file does not exist, or a value is refused.
    """
    variants = {variant.name: variant for variant in read_variants(path)}
    found = []
    for name, variant in variants.items():
        whole = chosen(name, variants)
        config = whole.config(METHODS[whole.method].config(), {})
        settings = starting_at(resolved(path.parent), variant.settings, config)
        refuse_lost_files(changed(config, settings, what=name), name)
        found.append(replace(variant, settings=settings))
    return tuple(found)


def adapted(
    preset: Preset,
    *,
    scene: str | None = None,
    photos: Path | None = None,
    fps: float | None = None,
    dark: Path | None = None,
    max_size: int | None = None,
    level: str | None = None,
    sensor: str | None = None,
    electrons: float | None = None,
    dark_frames: Path | None = None,
    methods: tuple[str, ...] | None = None,
    variants: tuple[Variant, ...] | None = None,
    cameras: CameraConfig | None = None,
    n_views: int | None = None,
    width: int | None = None,
    height: int | None = None,
    spp: int | None = None,
    points: int | None = None,
    iterations: int | None = None,
    denoiser_steps: int | None = None,
    score_at: tuple[int, ...] | None = None,
    hold_out: int | None = None,
    pictures: str | None = None,
    refine_cameras: bool = False,
    seed: int | None = None,
    device: str | None = None,
    parameters: tuple[str, ...] | None = None,
) -> Preset:
    """The preset with some settings changed; None keeps its own.

    The caller's own variants are compared with the preset's methods, unless `methods` lists everything. A `scene` that
    is a folder is photographed unchanged, and of `photos` (a folder or a video, with its `fps`) a set is made first;
    photographs are scaled to the preset's size unless `max_size` says another. Photographs that are `dark` already are
    imported unchanged, in their own size unless `max_size` says another. A `level` names camera, electrons and pictures
    (`levels.LEVELS`), of which each can be given by itself as well.

    Raises:
        ValueError: If a value is out of range, or one of a render is given for a folder.
    """
    if level is not None:
        named = level_named(level)
        sensor, pictures = sensor or named.sensor, pictures or named.pictures
        electrons = named.electrons if electrons is None else electrons
    folder = None if scene is None or not os.path.isdir(scene) else Path(scene)
    if folder is not None:
        _refuse_of_render(f"the set {folder}", views=n_views, width=width, height=height, spp=spp)
        scene = None
    bare = _bare(photos, fps, seed, also=None if folder is None and scene is None else "--scene")
    if bare is not None:
        _refuse_of_render(f"what --photos names ({photos})", views=n_views, width=width, height=height, spp=spp)
    imported = _changed(preset.imported, max_size=max_size)
    if max_size is None and (bare is not None or (folder is not None and not is_rendered(folder))):
        max_size = max(preset.render.width, preset.render.height)
    settings = {
        "fit.iterations": iterations, "fit.keep_at": score_at, "denoiser.warmup_steps": denoiser_steps,
        "pictures": pictures,
    }  # fmt: skip
    given = {name: value for name, value in settings.items() if value is not None}
    if refine_cameras:
        given["fit.refine_cameras"] = "default"
    if variants and methods is None:
        methods = (*preset.methods, *(v.name for v in variants if v.name not in preset.methods))
    return _changed(
        preset,
        render=_changed(
            preset.render,
            scene=scene,
            n_views=n_views,
            width=width,
            height=height,
            spp=spp,
            seed=seed,
            parameters=parameters,
        ),
        folder=folder,
        photos=bare,
        dark=dark,
        imported=imported,
        capture=_changed(
            preset.capture, sensor=sensor, electrons=electrons, dark_frames=dark_frames, max_size=max_size, seed=seed
        ),
        methods=methods,
        variants=variants,
        cameras=cameras,
        points=points,
        hold_out=hold_out,
        settings={**preset.settings, **given},
        device=device,
    )


def _bare(photos: Path | None, fps: float | None, seed: int | None, also: str | None) -> PosesConfig | None:
    """How to make a set of photographs; None without any."""
    if photos is None:
        if fps is not None:
            raise ValueError(f"--fps {fps:g} belongs to a video: name it with --photos")
        return None
    if also is not None:
        raise ValueError(f"give either --photos {photos} or {also}, not both")
    return _changed(PosesConfig(photographs=photos), fps=fps, seed=seed)


def _refuse_of_render(source: str, **given: int | None) -> None:
    if named := [f"--{name}" for name, value in given.items() if value is not None]:
        raise ValueError(f"{', '.join(named)} belong to a render, and {source} is photographed unchanged: leave out "
                         f"{'it' if len(named) == 1 else 'them'} (--max-size scales pictures down)")  # fmt: skip


def _changed(config: Config, **values: Any) -> Config:
    return replace(config, **{name: value for name, value in values.items() if value is not None})
