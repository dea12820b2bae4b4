"""The command line: the list of commands, and the entry point."""

import dataclasses
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from functools import wraps
from inspect import signature
from typing import Any, Literal, get_args, get_origin

import tyro

from novags.commands.answers.shown import FIRST_WORDS, annotations, completed, completing
from novags.commands.dataset import dataset
from novags.commands.every import HELP, without_common
from novags.commands.experiment import run
from novags.commands.inquiries import doctor, help_, list_
from novags.commands.looking import video, view
from novags.commands.new import new
from novags.commands.pareto import pareto
from novags.commands.photographs import denoise, import_
from novags.commands.results import characterise, explain, export_results, report, score, site, verify
from novags.commands.stages import capture, plan, poses, reconstruct, render
from novags.commands.store import store
from novags.commands.study import compare, compare_sets, study
from novags.failure import errors_in_one_line, warnings_in_one_line

TYPES = tyro.constructors.ConstructorRegistry()
COMMANDS: dict[str, Callable[..., None]] = {
    function.__name__.rstrip("_").replace("_", "-"): function
    for function in (
        run,
        study,
        store,
        dataset,
        pareto,
        list_,
        plan,
        render,
        poses,
        capture,
        import_,
        denoise,
        reconstruct,
        score,
        explain,
        verify,
        compare,
        compare_sets,
        report,
        view,
        video,
        export_results,
        site,
        characterise,
        new,
        doctor,
        help_,
    )
}


def main() -> None:
    """Entry point: run a command."""
    if sys.argv[1:] == ["--version"]:
        from importlib.metadata import version

        print(f"novags {version('novags')}")
        return
    with errors_in_one_line(), warnings_in_one_line():
        words, common = without_common(sys.argv[1:])
        if words and not words[0].startswith("-") and words[0] not in COMMANDS:
            from sensor_model.files.reading import meant  # numpy comes with it: --help must not wait for that

            raise ValueError(f"unknown command {words[0]!r:.80}; {meant(words[0], COMMANDS)}available: "
                             f"{', '.join(COMMANDS)}")  # fmt: skip
        if words and words[0] in COMMANDS:  # alone: with all commands to choose from, tyro takes a fifth longer
            with common, TYPES:
                tyro.cli(_checked(COMMANDS[words[0]], words), prog=f"novags {words[0]}", args=words[1:])
            return
        printed = words[:1] == ["--tyro-print-completion"] and bool({*words[1:2]} & FIRST_WORDS.keys())
        commands = {name: _checked(command, words if completing(words) else ()) for name, command in COMMANDS.items()}
        with common, TYPES, completed(COMMANDS, words) if printed else nullcontext():
            tyro.extras.subcommand_cli_from_dict(commands, prog="novags", description=DESCRIPTION, args=words)


@TYPES.primitive_rule
def _number(info: tyro.constructors.PrimitiveTypeInfo) -> tyro.constructors.PrimitiveConstructorSpec[Any] | None:
    """How tyro reads numbers: refused ones are named in one line where the option's name is known."""
    kind = info.type
    if kind not in (int, float):
        return None
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1, metavar=kind.__name__.upper(), instance_from_str=lambda words: _read(words[0], kind),
        is_instance=lambda found: isinstance(found, (int, kind)), str_from_instance=lambda found: [str(found)],
    )  # fmt: skip


@TYPES.primitive_rule
def _choice(info: tyro.constructors.PrimitiveTypeInfo) -> tyro.constructors.PrimitiveConstructorSpec[Any] | None:
    """How tyro reads one of several words: others are refused in one line. Completion needs tyro's."""
    choices = get_args(info.type)
    if get_origin(info.type) is not Literal or completing(sys.argv[1:]):
        return None

    def read(words: list[str]) -> Any:
        from sensor_model.files.reading import meant

        near = meant(words[0], choices).rstrip()
        return words[0] if words[0] in choices else _Refused(
            f"must be one of {', '.join(choices)}, got {words[0]!r:.80}{near and f'; {near}'}"
        )  # fmt: skip

    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1, metavar=f"{{{','.join(choices)}}}", instance_from_str=read,
        is_instance=lambda found: found in choices, str_from_instance=lambda found: [str(found)],
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class _Refused:
    """In place of a word that was refused: why."""

    why: str


def _read(word: str, kind: Any) -> Any:
    from novags.numbers import number  # numpy comes with it: --help must not wait for that

    try:
        return number(word, kind)
    except (ValueError, OverflowError) as error:
        return _Refused(str(error))


def _checked(command: Callable[..., None], words: Sequence[str]) -> Callable[..., None]:
    """The command, begun only if no word was refused; given the words of a line, as help and completion show it."""
    options_alone = {name for name, found in signature(command).parameters.items() if found.kind is found.KEYWORD_ONLY}

    @wraps(command)
    def checked(*given: Any, **options: Any) -> None:
        for name, refused in _refused(options):
            raise ValueError(f"{'--' if name in options_alone else ''}{name.replace('_', '-')} {refused.why}")
        command(*given, **options)

    if words:
        del checked.__wrapped__
        checked.__signature__ = signature(command)  # type: ignore[attr-defined]
        checked.__annotations__ = annotations(command, words)
    return checked


def _refused(options: dict[str, Any]) -> Iterator[tuple[str, _Refused]]:
    for name, value in options.items():
        if isinstance(value, _Refused):
            yield name, value
        elif isinstance(value, tuple):
            yield from ((name, part) for part in value if isinstance(part, _Refused))
        elif dataclasses.is_dataclass(value):
            yield from _refused(vars(value))


DESCRIPTION = (
    f"Test bed for low-light 3D reconstruction: rendered truth, dark captures, reconstructions, scores. {HELP}"
)
