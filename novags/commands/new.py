"""`novags new`: a file to start from."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from novags.commands.shared import next_, say
from novags.options import Name

Kind = Literal["method", "enhancer", "camera", "scene", "metric", "effect", "study"]
# How each file is tried, with {} for its name.
TRIED = {
    "method": "run --plugin {0}.py --methods naive {0} oracle",
    "enhancer": "run --plugin {0}.py --methods naive {0}-gs oracle",
    "camera": "run --plugin {0}.py --cameras {0}:step_deg=30",
    "scene": "run --plugin {0}.py --scene {0}",
    "metric": "score RUN --plugin {0}.py",
    "effect": "run --plugin {0}.py --sensor {0}.toml",
    "study": "study {0}.toml --out {0} --dry-run",
}


def new(kind: Annotated[Kind, tyro.conf.Positional], name: Name) -> None:
    """Write a working file to start from, into the working directory: NAME.py, a plugin, or NAME.toml, a study. An
    effect comes with NAME.toml, a camera that has it.

    Args:
        kind: The kind of file.
        name: Its name: letters, digits, and . _ + - after the first.
    """
    from sensor_model.files.atomic import write_text
    from sensor_model.files.outside import NAME

    if NAME.fullmatch(name) is None:
        raise ValueError(
            f"a name has letters, digits and . _ + - alone, and begins with one of the first; got {name!r:.80}"
        )
    files = {Path(f"{name}.toml" if kind == "study" else f"{name}.py"): template(kind)}
    if kind == "effect":
        files[Path(f"{name}.toml")] = template("effect-camera")
    for path in files:
        if path.exists() or path.is_symlink():
            raise ValueError(f"{path} is there already: choose another name, or move it")
    for path, text in files.items():
        write_text(path, text.replace("NAME", name))
        say(path)
    next_(f"novags {TRIED[kind].format(name)}")


def template(kind: str) -> str:
    """The text of such a file, with NAME for its name."""
    return (Path(__file__).with_name("answers") / "new" / f"{kind}.txt").read_text(encoding="utf-8")
