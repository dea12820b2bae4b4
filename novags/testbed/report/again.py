"""Commands that make a result again: relative to a folder, so that they hold wherever that folder goes."""

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from novags.cameras import SOURCES
from novags.cameras.spelling import source_named
from novags.methods import METHODS, chosen
from novags.methods.variant import Variant
from novags.testbed.folders.place import place_of
from novags.testbed.folders.run import Run
from novags.testbed.ledger.contents import jsonable
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset
from sensor_model.files import outside
from sensor_model.files.door import resolved

PRESET = "demo"  # what `novags reconstruct` starts from
# Options whose value may name a file or folder.
PATHS = ("--scene", "--photos", "--sensor", "--variant", "--curves", "--plugin")
DROPPED = {"--out": 1, "--wait": 0, "--overwrite": 0}  # options, and their values, that are about the first time
SHORT = {"fit.iterations": "--iterations", "denoiser.warmup_steps": "--denoiser-steps"}
AGAIN = "again"  # the folder that a repeated result goes to


def relative_command(words: Sequence[str], folder: Path) -> str:
    """A command line, without the program, that does the same into `again` when it is run in `folder`."""
    kept, skip, option = list[str](), 0, ""
    for word in words:
        name, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
        if name:
            option, skip = name.replace("_", "-"), 0
            if option in DROPPED:
                skip = 0 if equals else DROPPED[option]
            elif equals:
                kept.append(f"{name}={_moved(value, option, folder)}")
            else:
                kept.append(word)
        elif skip:
            skip -= 1
        else:
            kept.append(_moved(value, option, folder))
    return shlex.join(["novags", *kept, "--out", AGAIN])


def _moved(value: str, option: str, folder: Path) -> str:
    """A value with the path that it is, or holds, made relative to the folder."""
    if option == "--cameras":
        return re.sub(r"((?:checkpoint|home)=)([^,]+)", lambda m: m[1] + _path(m[2], folder), value)
    if option == "--variant" and not value.endswith(".toml"):
        name, colon, settings = value.partition(":")
        moved = re.sub(r"(?<=[=,])[^=,;]+", lambda m: _path(m[0], folder) if Path(m[0]).is_file() else m[0], settings)
        return f"{name}{colon}{moved}"
    return _path(value, folder) if option in PATHS and Path(value).exists() else value


def _path(value: str, folder: Path) -> str:
    found = os.path.relpath(resolved(Path(value).expanduser()), resolved(folder))
    # "set" could be a scene's name; "./set" is a path.
    return found if os.sep in found else os.path.join(".", found)


def run_again(run: Run, folder: Path, name: str | None = None) -> str | None:
    """The command that reconstructs as `run` was, from its capture, when it is run in `folder`.

    None where no command of this version leads to the same configuration. `name`: what tells the run from the others
    on its page, so that the result of each goes to a folder of its own; if not given, the run's own.
    """
    asked: dict[str, Any] = run.record["stage"]["config"]
    if METHODS.get(run.method) is None or not {"points", "seed", "cameras", "config"} <= asked.keys():
        return None
    if SOURCES.get(source_named(str(asked["cameras"]))) is None:
        return None
    if "given" in asked or "more" in run.record["stage"].get("inputs", {}):  # novags explain makes these again
        return None
    capture = os.path.relpath(place_of(run.path, run.record["capture"]), resolved(folder))
    wanted = _with_own_weights(run, folder, asked)
    words = ["novags", "reconstruct", capture, *_named(run.name, run.method, wanted, asked.get("fits", 1))]
    if len(words) == 3:
        return None
    cameras = _moved(str(asked["cameras"]), "--cameras", folder)
    words += ["--points", str(asked["points"]), "--seed", str(asked["seed"])]
    words += ["--hold-out", str(asked["hold_out"])] if "hold_out" in asked else []
    words += [] if cameras == "known" else ["--cameras", cameras]
    words += _plugins(run.record["stage"].get("versions", {}), folder)
    return shlex.join([*words, "--out", _place(name or run.name)])


def score_again(run: Run, folder: Path, name: str | None = None) -> str | None:
    """The commands that reconstruct and score as `run` was, when they are run in `folder`; rest as for `run_again`."""
    command = run_again(run, folder, name)
    if command is None:
        return None
    plugins = _plugins((run.metrics() or {}).get("stage", {}).get("versions", {}), folder)
    return f"{command} && {shlex.join(['novags', 'score', _place(name or run.name), *plugins])}"


def _plugins(versions: Mapping[str, str], folder: Path) -> list[str]:
    """The options that name the files of this command line that a result was made with."""
    used = [file for file in outside.files() if file.name in versions]
    return [word for file in used for word in ("--plugin", _path(str(file), folder))]


def _place(name: str) -> str:
    return f"{name.replace('/', '-')}-{AGAIN}"  # names of runs in several folders hold a slash


def _with_own_weights(run: Run, folder: Path, asked: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration that a run was asked for, with its own copy of weights that it was given as a file."""
    config: dict[str, Any] = asked["config"]
    if not _at(config, "enhance.weights") or run.enhancement is None:
        return config
    copies = [os.path.relpath(resolved(Path(file)), resolved(folder)) for file in run.enhancement["config"]["weights"]]
    return {**config, "enhance": {**config["enhance"], "weights": copies}}


def _named(name: str, method: str, wanted: Mapping[str, Any], fits: int) -> list[str]:
    """`--method` or `--variant` with what makes `wanted` of it; [] where nothing does."""
    known = _known(name)
    if known is not None and (known.method, known.fits) == (method, fits):
        short = {key: value for key, option in SHORT.items() if (value := _at(wanted, key)) is not None}
        if _asked(known, short) == wanted:
            options = [word for key, value in short.items() for word in (SHORT[key], str(value))]
            return ["--method", name, *options]
    if fits > 1:
        return []
    settings = _differing(_asked(Variant(name=name, method=method), {}), wanted)
    own = Variant(name=name, method=method, settings=settings)
    try:
        if settings and _asked(own, {}) == wanted:
            other = f"{name}-{AGAIN}" if name in METHODS else name  # a variant cannot have the name of a method
            return ["--variant", f"{other}={method}:{';'.join(f'{key}={value}' for key, value in settings.items())}"]
    except ValueError:  # a setting that this version does not have
        pass
    return []


def _known(name: str) -> Variant | None:
    with suppress(ValueError):
        return chosen(name)
    return None  # a variant of the caller's own


def _asked(variant: Variant, given: Mapping[str, Any]) -> Any:
    """The configuration that `novags reconstruct` makes of a variant, as recorded."""
    preset: Preset = EXPERIMENTS[PRESET]
    config = variant.config(METHODS[variant.method].config(), {**preset.settings, **given})
    return jsonable(ReconstructConfig(variant=variant, config=config).resolved()["config"])


def _at(config: Any, key: str) -> Any:
    for part in key.split("."):
        config = config.get(part) if isinstance(config, Mapping) else None
    return config


def _differing(base: Any, wanted: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Settings, as text, that turn one recorded configuration into another."""
    found: dict[str, str] = {}
    for name, value in wanted.items():
        before = base.get(name) if isinstance(base, Mapping) else None
        if isinstance(value, Mapping):
            found |= _differing(before, value, f"{prefix}{name}.")
        elif not isinstance(base, Mapping) or before != value:
            found[f"{prefix}{name}"] = _text(value)
    return found


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(map(_text, value))
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
