"""The stages that a study needs, shared ones once: folders of the store, and the inputs of each."""

import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from novags.cameras import check_cameras
from novags.cameras.sources.known import KnownConfig
from novags.methods import METHODS
from novags.settings import flattened
from novags.testbed.console.devices import chosen_device
from novags.testbed.console.terminal import Console
from novags.testbed.folders.set import for_photographs, open_source
from novags.testbed.ledger.code import code_of
from novags.testbed.ledger.contents import digest, folder_digest
from novags.testbed.ledger.store import key_of, named
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.posing import PosesConfig
from novags.testbed.stages.configs.reconstructing import files_of
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.importing import material_of
from novags.testbed.stages.posing import photographs_of
from novags.testbed.stages.rendering import scene_digest
from novags.testbed.study.cells.grid import Cell, Study
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.entry import Task, disk_of, peak_of
from novags.testbed.study.knobs.measurement import Measurement
from sensor_model.files.dng import SMALLEST
from sensor_model.files.door import resolved
from sensor_model.files.reading import brief
from simscenes.sets.writers.layouts import EXPORTS

TRAINED = 7 / 8  # of the views: every eighth is held out


@dataclass(frozen=True)
class StudyPlan:
    """Every task by key, each after the tasks it needs, and the runs of the study with their keys."""

    study: Study
    tasks: dict[str, Task]
    runs: tuple[tuple[Cell, str], ...]

    @cached_property
    def ends(self) -> frozenset[str]:
        """The keys of the runs, or of a data set's captures."""
        return frozenset(key for _, key in self.runs)

    def only(self, knobs: Sequence[str], kept: Collection[str]) -> "StudyPlan":
        """Of measurements: the needs of these knobs (none named: all), and finished measurements.

        Raises:
            ValueError: If there is no such knob.
        """
        names = self.study.axes["knob"]
        if missing := [name for name in knobs if name not in names]:
            raise ValueError(f"{self.study.table['measure']['subject']} has no knob {brief(repr(missing[0]), 100)}; "
                             f"its knobs: {', '.join(names)}")  # fmt: skip
        runs = tuple(run for run in self.runs if not knobs or run[0].values["knob"] in knobs or run[1] in kept)
        return replace(self, runs=runs, tasks={task.key: task for _, key in runs for task in self.above(key)})

    def above(self, key: str) -> Iterator[Task]:
        """A task and all its inputs, the first made first."""
        for need in self.tasks[key].needs:
            yield from self.above(need)
        yield self.tasks[key]


def plan_of(study: Study, store: Path, console: Console, *, here: bool = True) -> StudyPlan:
    """The tasks of a study; nothing is computed and nothing written.

    Args:
        study: The study.
        store: The store, from which paths to sets elsewhere are counted.
        console: Where notes on sets that are there go.
        here: The work will be done on this machine, so that it must have the device.

    Raises:
        ValueError: If a scene or a set cannot be read, settings do not go together, a camera source or a device is not
            on this machine, or two combinations mean the same run.
    """
    planner, runs, labels = Planner(store, console), [], dict[str, str]()
    for cell in study.cells:
        try:
            check(cell.preset, console, here)
            if cell.measured is not None:
                key = planner.measurement(cell.measured)
            else:
                key = planner.run(cell.preset) if study.ends == "run" else planner.capture(cell.preset)
        except ValueError as error:
            if str(study.path) in str(error):
                raise
            raise ValueError(f"{study.path}: {cell.label}: {error}") from error
        if key in labels and study.ends != "measurement":  # knobs may share the measurement of their defaults
            raise ValueError(
                f"{study.path}: [grid]: ({labels[key]}) and ({cell.label}) are the same {study.ends}, because what "
                "differs has no effect there: leave one out with [[exclude]]"
            )
        labels[key] = cell.label
        runs.append((cell, key))
    return StudyPlan(study, planner.tasks, tuple(runs))


def check(preset: Preset, console: Console, here: bool = True) -> None:
    """Refuse runs that are known to fail before anything is computed.

    Raises:
        ValueError: If it would.
    """
    check_cameras(preset.cameras)
    preset.refuse_lacking()
    program = preset.command(preset.methods[0])
    for folder in () if program is None else program.uncounted:
        console.warn(f"{preset.methods[0]}: its command names the folder {folder}, and a change in that makes no run "
                     f'again: if it is read, name it in files (files = ["{folder}"])')  # fmt: skip
    if program is not None and preset.cameras != KnownConfig():
        raise ValueError(f"cameras: {preset.methods[0]} is a program, which reads the true cameras (known) with its "
                         "pictures: leave the others out with [[exclude]]")  # fmt: skip
    if here:
        chosen_device(preset.device, console)
    rendered = preset.folder is None and preset.photos is None and preset.dark is None
    if rendered and min(preset.render.width, preset.render.height) < SMALLEST:
        size = f"{preset.render.width} x {preset.render.height}"
        raise ValueError(
            f"width and height must be >= {SMALLEST} px for runs, whose raw files LibRaw reads; got {size}"
        )


@dataclass
class Planner:
    """Plans entries of a store, each with all its inputs.

    Attributes:
        store: The store.
        console: Where notes on sets that are there go.
        tasks: The planned tasks, by key, each after the tasks it needs.
        contents: Of scenes and of sets that are there, read once.
        keys: Of sets and captures by their inputs, hashed once: many runs share them.
    """

    store: Path
    console: Console
    tasks: dict[str, Task] = field(default_factory=dict)
    contents: dict[Any, Any] = field(default_factory=dict)
    keys: dict[tuple[str, str], str] = field(default_factory=dict)

    def run(self, preset: Preset) -> str:
        """The key of a run, which is planned with all its inputs."""
        captured = self.capture(preset, for_runs=True)
        (name,) = preset.methods
        if (command := preset.command(name)) is not None:
            return self._command(command, captured)
        modules = self.tasks[captured].modules
        config = preset.reconstruct(name)
        recipe = {"name": name, "config": config.resolved(), "files": files_of(config), "capture": captured}
        key = key_of("run", recipe, config.code.along_with(modules))
        pixels = self.tasks[captured].pixels
        iterations = sum(v for k, v in flattened(config.config).items() if k.rpartition(".")[2] == "iterations")
        views = max(1, self._views(captured))
        return self._task(Task(
            kind="run", key=key, name=named(f"{name}-{self.tasks[captured].name.rpartition('-')[0]}", key),
            config=config, needs=(captured,), group=name, modules=modules,
            work=max(1, iterations) * (pixels / views + config.points), pixels=pixels,
            memory=METHODS[config.variant.method].memory(config.config, TRAINED * views, pixels / views, config.points),
        ))  # fmt: skip

    def measurement(self, config: Measurement) -> str:
        """The key of a measurement, which is planned with the capture of its seed where it needs one."""
        pictured = config.subject.pictured
        needs = () if pictured is None else (self.capture(pictured(config.seed)),)
        key = key_of("measurement", {**config.resolved(), "capture": needs}, config.code)
        name = f"{config.of}-{config.name}-{config.setting}-s{config.seed}"
        return self._task(Task(
            kind="measurement", key=key, name=named(name, key), config=config, needs=needs,
            group=f"{config.of}:{config.name} {config.setting}", work=1.0, pixels=1.0,
        ))  # fmt: skip

    def _command(self, config: CommandConfig, captured: str) -> str:
        name, pixels = config.name, self.tasks[captured].pixels
        key = key_of("run", {"name": name, "config": config.resolved(), "capture": captured}, config.code)
        return self._task(Task(
            kind="run", key=key, name=named(f"{name}-{self.tasks[captured].name.rpartition('-')[0]}", key),
            config=config, needs=(captured,), group=name, work=pixels, pixels=pixels,
        ))  # fmt: skip

    def _views(self, captured: str) -> int:
        return int(self.contents[captured])

    def capture(self, preset: Preset, *, for_runs: bool = False) -> str:
        """The key of a capture, which is planned with the set that it photographs."""
        if preset.dark is not None:
            return self._imported(preset.dark, preset.imported)
        config = preset.capture
        if preset.folder is None:
            made_of, source = self._posed(preset.photos) if preset.photos else self._set(preset.render), None
            pixels, views = self.tasks[made_of].pixels, self.contents[made_of]
            modules = self.tasks[made_of].modules
            name, content = self.tasks[made_of].name.rpartition("-")[0], {"set": made_of}
        else:
            source = resolved(preset.folder)
            content, views, pixels, modules = self._folder(source, config.max_size)
            name = source.name
        key = self._key("capture", config, content, modules)
        self.contents[key] = views
        parts = [name, config.sensor_name, f"{config.electrons:g}e", f"s{config.seed}"]
        return self._task(Task(
            kind="capture", key=key, name=named("-".join(parts), key), config=config, source=source,
            needs=() if source is not None else (made_of,), group=config.sensor_name,
            modules=(*modules, *config.modules), work=config.burst * pixels, pixels=pixels, for_runs=for_runs,
            disk=disk_of("capture", views, pixels, mosaic=config.camera.cfa is not None),
        ))  # fmt: skip

    def _imported(self, folder: Path, config: ImportConfig) -> str:
        """The key of a capture of photographs that are dark already; it holds all its inputs."""
        folder = Path(os.path.abspath(folder))  # not where a link leads: names tell the scene and the data set
        place = (folder, digest(config.resolved()), config.lit, config.clean, config.dataset)
        if place not in self.contents:
            material = material_of(folder, config, self.console)
            source = material.dark.source
            count = len(source.views)
            inputs, scene = material.inputs(), folder.name
            name = f"{inputs['dataset']}-{scene}" if inputs["dataset"] else scene
            self.contents[place] = (inputs, name, count, float(count * source.rig.width * source.rig.height))
        inputs, name, views, pixels = self.contents[place]
        key = key_of("capture", {"config": config.resolved(), "inputs": inputs, "scene": folder.name}, config.code)
        self.contents[key] = views
        return self._task(Task(
            kind="capture", key=key, name=named(name, key), config=config, source=folder, group="import",
            modules=config.modules, work=pixels, pixels=pixels,
        ))  # fmt: skip

    def _folder(self, path: Path, max_size: int | None) -> tuple[dict[str, Any], int, float, tuple[str, ...]]:
        """The identity of a set that is there, its number of views and of pixels, and `Source.modules`.

        Captures refer to it by its place, so that it is one of their inputs.
        """
        if (path, max_size) not in self.contents:
            source = open_source(path, self.console, max_size)
            content = {"content": source.digest(), "place": os.path.relpath(path, resolved(self.store))}
            views = len(source.views)
            pixels = float(views * source.rig.width * source.rig.height)
            self.contents[path, max_size] = (content, views, pixels, source.modules)
        content, views, pixels, modules = self.contents[path, max_size]
        return content, views, pixels, modules

    def _set(self, config: RenderConfig) -> str:
        scene = (config.scene, config.allow_outside, config.parameters)  # which may name files
        if scene not in self.contents:
            self.contents[scene] = scene_digest(config)
        key = self._key("set", config, {"scene": self.contents[scene]})
        pixels = float(config.n_views * config.width * config.height)
        samples = config.views_worth * config.width * config.height * (config.spp or 256)
        name = f"{config.source.name.replace(':', '')}-{config.n_views}x{config.width}x{config.height}"
        self.contents[key] = config.n_views
        return self._task(Task(
            kind="set", key=key, name=named(name, key), config=config, group=config.source.name,
            work=samples, pixels=pixels, disk=disk_of("set", config.n_views, pixels),
            memory=peak_of(config.most_samples),
        ))  # fmt: skip

    def _posed(self, config: PosesConfig) -> str:
        if config not in self.contents:
            files = photographs_of(config.photographs)
            content = folder_digest(config.photographs.parent, (), beside=files)
            self.contents[config] = (content, len(files))
        content, count = self.contents[config]
        key = key_of("set", {"config": config.resolved(), "photographs": content}, config.code)
        self.contents[key] = count
        pixels = float(count * (config.max_size or 4000) ** 2)
        return self._task(Task(
            kind="set", key=key, name=named(config.name, key), config=config, group="poses",
            modules=for_photographs(), work=pixels, pixels=pixels,
        ))  # fmt: skip

    def _key(
        self, kind: str, config: RenderConfig | CaptureConfig, made_of: dict[str, Any], modules: tuple[str, ...] = ()
    ) -> str:
        place = (kind, repr((config, made_of)))
        if place not in self.keys:
            recipe = {"config": config.resolved(), **_layouts(config), **made_of}
            self.keys[place] = key_of(kind, recipe, config.code.along_with(modules))
        return self.keys[place]

    def _task(self, task: Task) -> str:
        if task.key not in self.tasks:
            code = task.config.code.along_with(task.modules)
            self.tasks[task.key] = replace(task, code=code.key, roots=code.roots)
        return task.key


def _layouts(config: RenderConfig | CaptureConfig) -> dict[str, Any]:
    """Further layouts change no picture, but an entry that was made without them lacks requested files."""
    if not config.export:
        return {}
    written = code_of(*(EXPORTS.module_of(name) for name in config.export))
    return {"export": sorted(set(config.export)), "layouts": written.key}
