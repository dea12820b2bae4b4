"""What a newcomer's shell shows: presets in `--help`, names by the tab key, the nearest word, lists for programs."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, get_args

import pytest

from novags.cli import COMMANDS
from novags.commands.answers.catalogue import LISTS, listing, table
from novags.commands.answers.shown import _first_words, _metavar, annotations, completing
from novags.testbed.study.cells.presets import EXPERIMENTS

Call = Callable[..., int]


def helped(call: Call, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert call(*words, "--help") == 0
    return " ".join(capsys.readouterr().out.replace("│", " ").split())


@pytest.mark.parametrize("preset", [None, *EXPERIMENTS])
def test_help_shows_the_values_of_the_preset_that_is_named(
    call: Call, capsys: pytest.CaptureFixture[str], preset: str | None
) -> None:
    said = helped(call, capsys, "run", *([f"--preset={preset}"] if preset else []))
    expected = EXPERIMENTS[preset or "demo"]
    assert f"--views INT Number of views. ({expected.render.n_views} by the preset)" in said
    assert f"({' '.join(expected.methods)} by the preset)" in said
    fit = expected.reconstruct(expected.methods[0]).config.fit
    assert f"--iterations INT Of the fit. ({fit.iterations} by the preset)" in said


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_help_never_says_that_an_option_is_none(call: Call, capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert "default: None" not in helped(call, capsys, command)


TYPED = [
    ("recon", "reconstruct"), ("run --meth", "--methods"), ("run --methods naive nova-f", "nova-fast"),
    ("run --preset paper-", "paper-160"), ("run --sensor imx900-l", "imx900-lcg"), ("run --level llr", "llrs"),
    ("run --scene corn", "cornell"), ("render corn", "cornell"), ("reconstruct cap --method nova-p", "nova-plus"),
    ("reconstruct cap --cameras vggs", "vggsfm"), ("list enh", "enhancers"), ("new eff", "effect"),
    ("help elec", "electrons"), ("pareto spl", "splats"),
]  # fmt: skip


@pytest.fixture(scope="module", params=["bash", "zsh"])
def completion(request: pytest.FixtureRequest) -> tuple[str, str]:
    """A shell, and what it loads."""
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")  # a shell of the system, which no set-up of ours installs
    command = [sys.executable, "-m", "novags", "--tyro-print-completion", request.param]
    return request.param, subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(("typed", "expected"), TYPED)
def test_the_tab_key_completes_commands_options_and_names(
    completion: tuple[str, str], tmp_path: Path, typed: str, expected: str
) -> None:
    assert expected in offered(*completion, tmp_path, typed).split()


def test_no_shell_offers_a_line_of_a_help_text_as_a_word(completion: tuple[str, str], tmp_path: Path) -> None:
    lines = offered(*completion, tmp_path, "report --d").splitlines()
    assert [line.partition(":")[0].strip() for line in lines if line] == ["--dry-run"]


def offered(shell: str, loaded: str, tmp_path: Path, typed: str) -> str:
    """What the shell offers after these words and a tab."""
    words = ["novags", *typed.split()]
    (tmp_path / "_novags").write_text(loaded)
    if shell == "bash":
        program = (
            f'. "$1"\nCOMP_WORDS=({" ".join(words)}); COMP_CWORD={len(words) - 1}; COMP_LINE="{" ".join(words)}"\n'
            'COMP_POINT=${#COMP_LINE}; _novags; printf "%s\\n" "${COMPREPLY[@]}"'
        )
    else:  # zsh completes in a terminal only: its two builtins that take what is offered say it instead
        program = (
            f'fpath=("$2" $fpath); autoload -U _novags; words=({" ".join(words)}); CURRENT={len(words)}\n'
            'compadd() { shift; print -rl -- "$@"; }; _describe() { print -rl -- "${(P@)2%%:*}"; }; _novags'
        )
    done = subprocess.run([shell, "-c", program, shell, str(tmp_path / "_novags"), str(tmp_path)],
                          capture_output=True, text=True, check=True)  # fmt: skip
    return done.stdout


@pytest.mark.parametrize(
    ("words", "near"),
    [
        (("runn",), "did you mean 'run'?"), (("list", "metods"), "did you mean 'methods'?"),
        (("run", "--preset", "demmo"), "did you mean 'demo'?"), (("new", "methd", "x"), "did you mean 'method'?"),
        (("run", "--scene", "corneli"), "did you mean 'cornell'?"), (("render", "hal:3", "--out", "x"), "'hall'?"),
        (("run", "--sensor", "imx90-hcg"), "did you mean 'imx900-hcg'?"), (("run", "--level", "lmo"), "'lom'?"),
        (("run", "--device", "cpuu"), "--device must be one of auto, cpu, cuda, got 'cpuu'; did you mean 'cpu'?"),
    ],
)  # fmt: skip
def test_the_nearest_word_is_said_in_one_line(
    call: Call, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], near: str
) -> None:
    assert call(*words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("novags: error: ")
    assert near in line


def test_an_unknown_option_is_said_with_the_near_one(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("run", "--metods", "naive") == 2
    assert "Perhaps you meant: --methods" in " ".join(capsys.readouterr().err.replace("│", " ").split())


@pytest.mark.parametrize("what", ["all", *LISTS])
def test_a_program_reads_the_lists_as_json(call: Call, capsys: pytest.CaptureFixture[str], what: str) -> None:
    assert call("list", what, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == (list(LISTS) if what == "all" else [what])
    shown = " ".join(listing(what).split())
    assert all(name in shown and text.split()[0] in shown for rows in found.values() for name, text in rows.items())
    assert not any("FILE" in name or ":" in name for rows in found.values() for name in rows)  # each can be given


@pytest.mark.parametrize("order", [("a", "longest", "mid"), ("longest", "mid", "a"), ("mid", "a", "longest")])
def test_the_texts_of_a_list_stand_in_one_column_beside_the_longest_name(order: tuple[str, ...]) -> None:
    rows = {"a": ("short", "  a        short"), "longest": ("text", "  longest  text"), "mid": ("or", "  mid      or")}
    assert table({name: rows[name][0] for name in order}).splitlines() == [rows[name][1] for name in order]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_completion_is_asked_for_at_any_place_of_a_line(place: int) -> None:
    words = ["run", "--quiet"]
    assert not completing(words)
    assert completing([*words[:place], "--tyro-write-completion", *words[place:]])


def test_an_option_of_several_types_shows_all_but_none() -> None:
    assert _metavar(int | Literal["all", "few"] | None) == "INT|{all,few}"
    assert _metavar(Annotated[str | None, "help"]) == "STR"
    assert _metavar(tuple[str, ...] | None) == "[STR ...]"


def test_names_are_completed_for_every_option_that_takes_them_and_it_may_still_be_absent() -> None:
    words = ["--tyro-print-completion", "bash"]
    shown = annotations(COMMANDS["run"], words)
    for option, names in (("scene", "scenes"), ("sensor", "sensors"), ("level", "levels")):
        choice, absent = get_args(shown[option])
        assert (set(get_args(choice)), absent) == (set(LISTS[names]()), type(None))
    methods, absent = get_args(shown["methods"])
    assert (set(get_args(get_args(methods)[0])), absent) == (set(LISTS["methods"]()), type(None))
    assert shown["views"] == COMMANDS["run"].__annotations__["views"]


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_every_command_whose_first_word_is_a_name_has_a_case(shell: str) -> None:
    said = _first_words(COMMANDS, ["--tyro-print-completion", shell])
    cases = dict(line.strip().partition(") names=")[::2] for line in said.splitlines() if ") names=" in line)
    assert set(cases) >= {"help", "list", "new", "pareto", "render"}
    assert all(name in cases["render"] for name in LISTS["scenes"]())
