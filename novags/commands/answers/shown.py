"""What `--help` and tab completion say of a command's options, beyond its signature."""

import inspect
import io
import re
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from novags.options import absent

LISTED = {"scene": "scenes", "sensor": "sensors", "level": "levels", "method": "methods", "methods": "methods",
          "cameras": "cameras"}  # fmt: skip
WORDS = {str: "STR", int: "INT", float: "FLOAT", Path: "PATH"}

FIRST_WORDS = {
    "bash": """
_novags_options=$(complete -p novags | sed 's/.*-F \\([^ ]*\\).*/\\1/')
_novags() {{
  local names=
  "$_novags_options" "$@"
  case ${{COMP_WORDS[1]}} in
{cases}
  esac
  if [ "$COMP_CWORD" = 2 ]; then COMPREPLY+=($(compgen -W "$names" -- "${{COMP_WORDS[2]}}")); fi
}}
complete -o default -F _novags novags""",
    # the end of tyro's file, which zsh loads as the body of a function, counting words from 1
    "zsh": """
local names=
case ${{words[2]}} in
{cases}
esac
if (( CURRENT == 3 )); then compadd -- ${{=names}}; fi""",
}


def completing(words: Sequence[str]) -> bool:
    """Whether a shell's completion is asked for, not a command."""
    return any(word.startswith(("--tyro-print-completion", "--tyro-write-completion")) for word in words)


def annotations(command: Callable[..., None], words: Sequence[str]) -> dict[str, Any]:
    """The types of a command's parameters as tyro is to show them.

    An option that need not be given shows the value that the preset has for it, and never None. A completion is told
    the names that an option takes.
    """
    parameters = inspect.signature(command).parameters
    hints = {name: parameter.annotation for name, parameter in parameters.items()}
    if completing(words):
        return {name: _one_of(hint, names) if (names := _names(name)) else hint for name, hint in hints.items()}
    asked = "preset" in parameters and {"-h", "--help"} & set(words)
    known = _of_preset(words) if asked else {}
    for name, parameter in parameters.items():
        if parameter.default is None:
            preset = f"({known[name]} by the preset)" if name in known else ""
            hints[name] = Annotated[hints[name], absent(_metavar(hints[name]), preset)]
    return hints


@contextmanager
def completed(commands: Mapping[str, Callable[..., None]], words: Sequence[str]) -> Iterator[None]:
    """Print tyro's completion, which is made within, as the shell needs it that the second word names."""
    said = io.StringIO()
    try:
        with redirect_stdout(said):
            yield
    finally:
        # zsh would offer the second line of a help text as a word of its own
        joined = re.sub("^COMPLETION_SPEC = .*", lambda spec: spec[0].replace(r"\n", " "), said.getvalue(), flags=re.M)
        print(joined, _first_words(commands, words), sep="\n")


def _first_words(commands: Mapping[str, Callable[..., None]], words: Sequence[str]) -> str:
    """What the shell has to be told beside tyro's completion: words that belong to no option."""
    cases = []
    for name, command in commands.items():
        parameter = next(iter(inspect.signature(command).parameters.values()), None)
        if parameter is None or parameter.kind is parameter.KEYWORD_ONLY:
            continue
        first = annotations(command, words)[parameter.name]
        if choices := [word for kind in (_bare(first), *get_args(_bare(first))) if get_origin(kind) is Literal
                       for word in get_args(kind)]:  # fmt: skip
            cases.append(f"    {name}) names='{' '.join(choices)}' ;;")
    return FIRST_WORDS[words[1]].format(cases="\n".join(cases))


def _of_preset(words: Sequence[str]) -> dict[str, Any]:
    """What the preset that the words name has for options of commands."""
    from novags.testbed.study.cells.presets import EXPERIMENTS

    _, _, named = " ".join(words).replace("--preset=", "--preset ").partition("--preset ")
    preset = EXPERIMENTS.get((named.split() or ["demo"])[0], EXPERIMENTS["demo"])
    render, capture, config = preset.render, preset.capture, preset.reconstruct(preset.methods[0]).config
    denoiser = getattr(config, "denoiser", None)
    known = {
        "scene": render.scene, "views": render.n_views, "width": render.width, "height": render.height,
        "spp": render.spp, "sensor": capture.sensor, "electrons": f"{capture.electrons:g}", "seed": capture.seed,
        "methods": " ".join(preset.methods), "points": preset.points, "iterations": config.fit.iterations,
        "denoiser_steps": preset.settings.get("denoiser.warmup_steps", getattr(denoiser, "warmup_steps", None)),
    }  # fmt: skip
    return {name: value for name, value in known.items() if value is not None}


def _metavar(hint: Any) -> str:
    """As tyro writes a type that is not None."""
    kinds = [kind for kind in get_args(_bare(hint)) if kind is not types.NoneType]
    return "|".join("{" + ",".join(get_args(kind)) + "}" if get_origin(kind) is Literal
                    else f"[{WORDS[get_args(kind)[0]]} ...]" if get_origin(kind) is tuple
                    else WORDS[kind] for kind in kinds)  # fmt: skip


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _names(parameter: str) -> tuple[str, ...]:
    """The names that a parameter takes; none if it takes other words."""
    from novags.commands.answers.catalogue import LISTS
    from novags.commands.answers.topics import topics
    from novags.testbed.study.knobs.subjects import subjects

    if parameter in LISTED:
        return tuple(LISTS[LISTED[parameter]]())
    return {"topic": topics(), "what": (*subjects(), "all")}.get(parameter, ())


def _one_of(hint: Any, names: tuple[str, ...]) -> Any:
    """The type with text replaced by a choice of names."""
    if hint is str:
        return Literal[names]
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return Annotated[(_one_of(parts[0], names), *hint.__metadata__)]
    if origin is tuple:
        return tuple[_one_of(parts[0], names), ...]  # type: ignore[misc] # of a value
    if origin in (Union, types.UnionType):
        return Union[tuple(_one_of(part, names) for part in parts)]  # noqa: UP007 - of a tuple
    return hint
