"""Claims about numbers that people write: every option and every setting refuses what nobody can mean, in one line."""

import dataclasses
import inspect
import math
import re
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import pytest

from novags import cli
from novags.cameras import SOURCES, parse_cameras
from novags.methods import METHODS
from novags.methods.variant import parse_variant
from novags.numbers import check_range, number, shown
from novags.settings import flattened
from sensor_model.files import lock

Call = Callable[..., int]
LONG, LONGER = "9" * 400, "9" * 5000  # Python itself reads no more than 4300 digits
WRONG = {
    "INT": (LONG, LONGER, f"-{LONG}", str(2**64), str(2**63), str(2**31), "-1", "nan", "inf", "1e308", "1e3", ""),
    "FLOAT": (LONG, LONGER, "nan", "inf", "-inf", "1e308", "1e37", "-1", ""),
}
CALLED = {"denoiser-steps": "(denoiser-steps|warmup_steps)", "score-at": "(score-at|keep_at)"}  # by the configuration
MEANT = {
    "base": "nova-fast",
    "changed": "nova",
    "what": "render",
    "scene": "tabletop",
    "sensor": "ideal",
    "electrons": "9",
}
CALLED["seeds"] = "seed"
CALLED["tolerance"] = "(tolerance|sd)"  # as the planner calls it
RIGHT = {(name, str(2**bits)) for name in ("seed", "seeds") for bits in (31, 63)}
RIGHT |= {("aperture-radius", "1e37"), ("focus-distance", "1e37")}


@pytest.fixture
def nothing_begins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Every command that comes to its work fails there, by an AssertionError, which is exit code 1."""
    real = lock.locked
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sensor_model.files.lock.locked", _begun)
    monkeypatch.setattr("novags.commands.shared.console", _begun)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    yield
    for module in list(sys.modules.values()):  # those that were imported meanwhile have the replacement
        if vars(module).get("locked") is _begun:
            module.locked = real  # type: ignore[attr-defined]


def _begun(*_: object, **__: object) -> None:
    raise AssertionError("the work has begun")


def _needed(command: str) -> list[str]:
    """Words that a command does not do without."""
    words = []
    for name, parameter in inspect.signature(cli.COMMANDS[command]).parameters.items():
        if parameter.default is inspect.Parameter.empty:
            option = [] if parameter.kind is parameter.POSITIONAL_OR_KEYWORD else [f"--{name}"]
            words += [*option, MEANT.get(name, f"no-{name}")]
    return words


@pytest.mark.usefixtures("nothing_begins")
@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_every_number_of_every_command_is_bounded_before_its_work_begins(
    call: Call, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert call(command, "--help") == 0
    options = re.findall(r"--([a-z-]+) (?:\{None\}\||\[)?(INT|FLOAT)\b", capsys.readouterr().out)
    numbers = [name for name in inspect.signature(cli.COMMANDS[command]).parameters.values()
               if name.annotation in (int, float, int | None, float | None)]  # fmt: skip
    assert len(options) >= len(numbers)
    for option, kind in options:
        for value in WRONG[kind]:
            if (option, value) in RIGHT:
                continue
            code = call(command, *_needed(command), f"--{option}={value}")
            error = capsys.readouterr().err
            case = f"{command} --{option}={value[:40]}: exit code {code}, {error[:1000]}"
            assert code == 2, case
            assert len(error.splitlines()) == 1, case
            assert re.search(CALLED.get(option, option.replace("-", "[-_ ]")), error), case
            assert len(error) < 400, case


def _numbers_of(hint: Any) -> str | None:
    """INT or FLOAT, if a field of this type is a number or several."""
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    options = tuple(get_args(o)[0] if get_origin(o) is tuple else o for o in options)
    return next((name for kind, name in ((int, "INT"), (float, "FLOAT")) if kind in options), None)


def _fields(config: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    hints = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from _fields(value, f"{prefix}{field.name}.")
        elif kind := _numbers_of(hints[field.name]):
            yield f"{prefix}{field.name}", kind


@pytest.mark.parametrize("method", list(METHODS))
def test_every_number_of_a_variant_is_bounded(method: str) -> None:
    default = METHODS[method].config()
    assert len(list(_fields(default))) <= len(flattened(default))
    for name, kind in _fields(default):
        for value in (v for v in WRONG[kind] if v not in ("", "1e37", "-1", str(2**31))):
            if name.endswith("seed") and value == str(2**63):
                continue
            variant = parse_variant(f"x={method}:{name}={value}")
            with pytest.raises(ValueError, match=re.escape(name.rpartition(".")[2])) as said:
                variant.config(default, {})
            assert len(str(said.value)) < 400


POSITIVE = ("known", "sfm", "hloc", "vggt", "dust3r", "mast3r", "vggsfm")  # an angle of another may be negative


@pytest.mark.parametrize("source", list(SOURCES))
def test_every_number_of_a_camera_source_is_bounded(source: str) -> None:
    config = SOURCES[source].config
    required = [f.name for f in dataclasses.fields(config)
                if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING]  # fmt: skip
    hints = get_type_hints(config)
    given = {name: "1" if _numbers_of(hints[name]) else "x" for name in required}
    for name, hint in hints.items():
        for value in WRONG.get(str(_numbers_of(hint)), ()):
            if value in ("", "1e37") or (value == "-1" and (source not in POSITIVE or name == "first_octave")):
                continue
            with pytest.raises(ValueError, match=name) as said:
                parse_cameras(f"{source}:{','.join(f'{k}={v}' for k, v in {**given, name: value}.items())}")
            assert len(str(said.value)) < 400


@pytest.mark.usefixtures("nothing_begins")
@pytest.mark.parametrize("value", [LONG, LONGER, "nan", "-1", "1e400", str(2**70)])
@pytest.mark.parametrize(
    "words",
    [
        ("run", "--budget", "{}s"),
        ("run", "--scene", "tabletop:{}"),
        ("render", "tabletop:{}", "--out", "x"),
        ("study", "x.toml", "--out", "x", "--engine", "ray", "--needs", "cpus={}"),
        ("study", "x.toml", "--out", "x", "--engine", "ray", "--needs", "run:memory={}GB"),
    ],
)
def test_numbers_within_words_are_bounded(
    call: Call, capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...], value: str
) -> None:
    (tmp_path / "x.toml").write_text("[grid]\nseed = 1\n")
    assert call(*(word.format(value) for word in words)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert len(line) < 400


def test_a_number_keeps_its_value_and_its_kind() -> None:
    assert (number("7", int), number("-0.5", float), number(3, float), number(4.0, int)) == (7, -0.5, 3.0, 4)
    assert number(str(2**64 - 1), int) == 2**64 - 1


@pytest.mark.parametrize("value", [2**64, -(2**64), math.inf, LONG, LONGER, f" {LONGER}", 10**400])
def test_a_whole_number_beyond_64_bits_is_too_large(value: Any) -> None:
    with pytest.raises(OverflowError, match=r"must be a whole number below 2\*\*64, got .{1,80}$"):
        number(value, int)


@pytest.mark.parametrize("value", [3.5e38, math.inf, -math.inf, math.nan, "nan", "1e400", LONG, LONGER, 10**400])
def test_a_number_beyond_32_bits_is_too_large(value: Any) -> None:
    with pytest.raises(OverflowError, match=r"must be a finite number below 3.4e\+38, got .{1,80}$"):
        number(value, float)


def test_a_range_says_which_end_was_passed() -> None:
    check_range("n", 1, 1, 3)
    for value, rule in ((0, ">= 1"), (4, "<= 3"), (math.nan, ">= 1")):
        with pytest.raises(ValueError, match=f"n must be {rule}, got {value}"):
            check_range("n", value, 1, 3)


def test_digits_of_a_long_number_are_not_repeated() -> None:
    assert shown(10**5000) == "one of about 5000 digits"
    assert shown(12) == "12"


@pytest.mark.parametrize("nodes", [(0, 1), (1, 0)])
def test_every_number_of_machines_is_bounded(nodes: tuple[int, ...]) -> None:
    from novags.commands.study import CLUSTER, check_numbers

    check_numbers(None, CLUSTER, (1, 2))
    with pytest.raises(ValueError, match="nodes must be >= 1"):
        check_numbers(None, CLUSTER, nodes)
