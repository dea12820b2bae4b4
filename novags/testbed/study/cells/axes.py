"""Changes of a preset by the keys of a study file: scene, rig, camera, method, or any setting of a stage or a
method.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from novags.cameras import parse_cameras
from novags.cameras.source import CameraConfig
from novags.methods import METHODS
from novags.methods.variant import Variant
from novags.settings import changed, check_types, converted, flattened, has_setting, starting_at
from novags.testbed.importing.published.named import DATA
from novags.testbed.study.cells.levels import level_named
from novags.testbed.study.cells.presets import Preset, adapted
from sensor_model.files.camera_file import split_iso
from sensor_model.files.door import resolved
from sensor_model.presets import PRESETS as SENSORS
from simscenes.loading.reference import is_scene_file
from simscenes.scenes import canonical_name

RENAMED = {"views": "n_views"}  # as the command line calls them -> as `adapted` does
SPELLED = {name: key for key, name in RENAMED.items()}
NOT_AXES = (
    "preset",
    "return",
    "methods",
    "variants",
    "n_views",
    "dark",
    "dark_frames",
)  # the last: capture.dark_frames
STAGES = {"render": "render", "capture": "capture", "import": "imported"}  # render.max_depth -> of `Changes`, `Preset`
# The settings of the short keys, where a dotted key sets the same.
SETS = {
    "scene": ("render.scene",), "n_views": ("render.n_views",), "width": ("render.width",),
    "height": ("render.height",), "spp": ("render.spp",), "parameters": ("render.parameters",),
    "sensor": ("capture.sensor",), "electrons": ("capture.electrons",),
    "max_size": ("capture.max_size", "import.max_size"), "iterations": ("fit.iterations",),
    "denoiser_steps": ("denoiser.warmup_steps",), "score_at": ("fit.keep_at",),
    "refine_cameras": ("fit.refine_cameras",),
}  # fmt: skip
OF_RENDER = ("views", "width", "height", "spp")  # of no use to a set that is there already
OF_CAPTURE = ("sensor", "electrons")  # of no use to photographs that are dark already
# Of use to reconstructions alone.
OF_RUNS = ("method", "cameras", "points", "iterations", "denoiser_steps", "score_at", "hold_out", "pictures",
           "refine_cameras", "device")  # fmt: skip


@dataclass(frozen=True)
class Changes:
    """The changes by some keys, sorted by their place.

    Attributes:
        adapted: Keywords of `presets.adapted`.
        render: Settings of the render by dotted name.
        capture: Settings of the capture by dotted name.
        imported: Settings of the import of dark photographs by dotted name.
        settings: Settings of methods by dotted name.
    """

    adapted: dict[str, Any] = field(default_factory=dict)
    render: dict[str, Any] = field(default_factory=dict)
    capture: dict[str, Any] = field(default_factory=dict)
    imported: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)

    def and_(self, other: "Changes") -> "Changes":
        """Both; the other's where both change the same."""
        mine, more = vars(self), vars(other)
        return Changes(**{name: {**mine[name], **more[name]} for name in mine})

    def names(self) -> dict[str, str]:
        """The settings they change, by one name whichever key does, and the key."""
        stages, found = {place: f"{stage}." for stage, place in STAGES.items()}, dict[str, str]()
        for place, settings in vars(self).items():
            for name in settings:
                key = f"{stages.get(place, '')}{name}"
                found |= dict.fromkeys(SETS.get(key, (key,)), SPELLED.get(key, key))
        return found

    def of_render(self) -> list[str]:
        """Which of them only a render can obey."""
        return [key for key in OF_RENDER if _keyword(key) in self.adapted] + [f"render.{key}" for key in self.render]

    def without_render(self) -> "Changes":
        """The rest of them for a set that is there already."""
        kept = {name: value for name, value in self.adapted.items() if name not in map(_keyword, OF_RENDER)}
        return replace(self, adapted=kept, render={})

    def of_capture(self) -> list[str]:
        """Which of them only a simulated exposure can obey."""
        return [key for key in OF_CAPTURE if key in self.adapted] + [f"capture.{key}" for key in self.capture]


@cache
def _hints() -> dict[str, Any]:
    return get_type_hints(adapted)


@cache
def known_keys() -> tuple[str, ...]:
    """Every key but the dotted ones."""
    names = [name for name in _hints() if name not in NOT_AXES]
    return ("rig", "method", *RENAMED, *names)


def changes_of(key: str, value: Any, folder: Path, data: Mapping[str, Path] | None = None) -> Changes:
    """The changes by one key with one value.

    Args:
        key: Of [grid] (but "rig", which stands for several keys), [override] or [rig.NAME].
        value: As TOML holds it.
        folder: Where relative paths start: the study file's folder.
        data: The scenes of data sets that are there: "LOM/buu" and its folder.

    Raises:
        ValueError: If there is no such key, or the value has the wrong type.
    """
    stage, dot, name = key.partition(".")
    if key == "capture.seed":
        raise ValueError("the noise has the seed of the run: write seed")
    if dot and stage in STAGES:
        return Changes(**{STAGES[stage]: {name: _whole_path_of_stage(key, value, folder)}})
    if key == "scene" and (name := _text(value)).startswith(DATA):
        if (path := (data or {}).get(name.removeprefix(DATA))) is None:
            raise ValueError(f"{name} was not found: --data DIR says where the data sets are")
        return Changes(adapted={"dark": path})
    if key in known_keys():
        return Changes(adapted=_keywords(key, value, folder))
    for method in METHODS.values():
        if has_setting(config := method.config(), key):
            return Changes(settings=_whole_paths(config, key, value, folder))
    known = (*known_keys(), *(name for method in METHODS.values() for name in flattened(method.config())))
    near = get_close_matches(key, known, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known_keys())}, settings of methods, "
    hint += "" if near else "and settings of stages as render.NAME, capture.NAME and import.NAME"
    raise ValueError(f"there is no such key; {hint}")


def _keywords(key: str, value: Any, folder: Path) -> dict[str, Any]:
    if key == "method":
        return {"methods": (_text(value),)}
    if key == "cameras":
        return {"cameras": _cameras(_text(value), folder)}
    if key == "scene":
        return {"scene": scene_of(_text(value), folder)}
    if key == "photos":
        if not os.path.exists(path := folder / Path(_text(value)).expanduser()):
            raise ValueError(f"there are no photographs {path}")
        return {"photos": path}
    if key == "level":
        return level_named(_text(value)).settings()  # each by its name, so that another key for one of them is refused
    if key == "sensor":
        value = _sensor(value, folder)
    hint = _hints()[_keyword(key)]
    return {_keyword(key): converted(value, hint, "it")}


def _whole_path_of_stage(key: str, value: Any, folder: Path) -> Any:
    """A setting of a stage; a file or a folder by its whole path."""
    if key == "render.scene":
        return scene_of(_text(value), folder)
    if key in ("capture.sensor", "import.sensor"):
        return _sensor(value, folder)
    if (
        key in ("import.lit", "import.clean", "capture.dark_frames")
        and isinstance(value, str)
        and value.lower() != "none"
    ):
        return folder / Path(_text(value)).expanduser()
    return value


def _sensor(value: Any, folder: Path) -> Any:
    """A camera by its name; its file by the whole path."""
    is_file = isinstance(value, str) and value not in SENSORS and split_iso(value)[0].endswith(".toml")
    return str(folder / Path(value).expanduser()) if is_file else value


def _whole_paths(config: Any, key: str, value: Any, folder: Path) -> dict[str, Any]:
    """A setting of methods; files by their whole path."""
    try:
        return starting_at(folder, {key: value}, changed(config, {key: value}))
    except ValueError:  # which says so where it is known whose setting it is
        return {key: value}


def _keyword(key: str) -> str:
    return RENAMED.get(key, key)


def _cameras(value: str, folder: Path) -> CameraConfig:
    """A camera source by name and settings; files and folders among these by their whole path."""
    config = parse_cameras(value)
    given = {f.name: getattr(config, f.name) for f in fields(config)}
    paths: dict[str, Any] = {name: folder / path for name, path in given.items() if isinstance(path, Path)}
    return replace(config, **paths)


def scene_of(value: str, folder: Path) -> str:
    """A scene of the catalogue by its one name; a file or a folder by its whole path.

    Args:
        value: As a file of a study or of a data set spells it.
        folder: Of that file.

    Raises:
        ValueError: If the catalogue has no such scene, or the file does not exist.
    """
    path = folder / Path(value).expanduser()
    if is_scene_file(value) and not os.path.isfile(path):
        raise ValueError(f"the scene file {path} does not exist")
    return str(path) if is_scene_file(value) or os.path.isdir(path) else canonical_name(value)


def scene_identity(scene: str) -> str:
    """The identity behind all spellings of a scene: its one name, or where the file or folder really is."""
    return str(resolved(Path(scene))) if is_scene_file(scene) or os.path.isdir(scene) else scene


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"it must be text, got {value!r}")
    if not value.strip():
        raise ValueError("it is empty")  # as a path it would be the folder of the study
    return value


def applied(base: Preset, changes: Changes, variants: tuple[Variant, ...] = ()) -> Preset:
    """The preset with all changes.

    A seed counts for the noise and for training. The render keeps its own, so that one set serves all seeds.

    Raises:
        ValueError: If a value is out of range or does not go with another.
    """
    keywords = dict(changes.adapted)
    seed = keywords.pop("seed", None)
    preset = adapted(base, **keywords, variants=variants or None)
    capture = changed(preset.capture, _with_seed(changes.capture, seed), what="capture")
    render = changed(preset.render, changes.render, what="render")
    imported = changed(preset.imported, changes.imported, what="import")
    if preset.folder is None and preset.dark is None:
        _ = render.source  # refuses a scene that there is not
    settings = {**preset.settings, **changes.settings}
    return replace(preset, render=render, capture=capture, imported=imported, settings=settings)


def check_keys(base: Preset, changes: Changes) -> None:
    """Refuse settings of stages that there are not, or of another type; values are seen by `applied`, all together.

    Raises:
        ValueError: If there is one.
    """
    for stage, place in STAGES.items():
        check_types(getattr(base, place), getattr(changes, place), what=stage)


def _with_seed(settings: Mapping[str, Any], seed: int | None) -> dict[str, Any]:
    return dict(settings) if seed is None else {"seed": seed, **settings}
