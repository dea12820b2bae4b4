"""A process that is killed at any moment costs nothing finished and leaves nothing behind: the same command again ends
with the folder that it would have made at once, logs and hidden files included.
"""

import signal
from collections.abc import Callable
from pathlib import Path

import pytest

SAMPLE = 3  # moments of each stage in the default run, besides the first one and those around its record
KILLED = -9


@pytest.mark.parametrize("name", ["render", "capture", "capture again", "reconstruct", "score", "report"])
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["some", "every"])
def test_a_stage_killed_at_any_file_event_ends_up_the_same(
    name: str, every: bool, server, begun: Callable[..., Path], same_as_reference: Callable[[str, Path], list[str]],
    stages,
) -> None:  # fmt: skip
    stage = stages[name]
    whole = server.run(begun(name), stage.command, events=stage.out)
    assert whole.code == 0, whole.said
    count = len(whole.events)
    parts = SAMPLE - 1 if name == "render" else SAMPLE  # which takes longest
    spread = {round(k * (count - 1) / parts) for k in range(parts + 1)}
    saved = [k for k, event in enumerate(whole.events) if event.startswith("os.rename") and "checkpoint" in event]
    # Right before the last checkpoint the log is ahead of the one that is there.
    moments = range(count) if every else sorted(spread | {count - 2} | set(saved[-1:]))
    wrong = {}
    for moment in moments:
        folder = begun(name, moment)
        killed = server.run(folder, stage.command, events=stage.out, kill=moment)
        assert killed.code == KILLED, killed.said
        again = server.run(folder, stage.command)
        if again.code or (different := same_as_reference(name, folder)):
            wrong[f"{moment}: {whole.events[moment]}"] = again.line if again.code else different
    assert not wrong


@pytest.mark.slow
def test_an_experiment_killed_anywhere_ends_up_the_same(
    server, begun: Callable[..., Path], experiment: list[str], tree: Callable[[Path], dict[str, object]]
) -> None:
    faults: dict[str, list[object]] = {"no llvm": []}  # the other variant would start its threads in every child
    first = begun("render", "whole")
    whole = server.run(first, experiment, events="all", faults=faults)
    assert whole.code == 0, whole.said
    count, wrong = len(whole.events), {}
    for moment in range(0, count, count // 25):
        folder = begun("render", moment)
        assert server.run(folder, experiment, events="all", kill=moment, faults=faults).code == KILLED
        again = server.run(folder, experiment, faults=faults)
        if again.code or tree(folder) != tree(first):
            wrong[f"{moment}: {whole.events[moment]}"] = again.line
    assert not wrong


@pytest.mark.parametrize(
    ("name", "at", "number"),
    [("capture", "images/0001.png", signal.SIGTERM), ("reconstruct", "exr/0002.exr", signal.SIGINT)],
)
def test_an_interrupted_stage_says_how_to_go_on_and_keeps_what_is_done(
    name: str, at: str, number: int, server, begun: Callable[..., Path],
    same_as_reference: Callable[[str, Path], list[str]], stages, page,
) -> None:  # fmt: skip
    folder, stage = begun(name), stages[name]
    events = server.run(begun(name, "whole"), stage.command, events=stage.out).events
    parent, _, file = at.rpartition("/")
    moment = next(k for k, e in enumerate(events) if e.startswith("os.rename") and parent in e and f".{file[:4]}." in e)
    stopped = server.run(folder, stage.command, events=stage.out, kill=moment, signal=number)
    assert stopped.code == 130
    assert page["interrupted (Ctrl-C, SIGTERM)"].fullmatch(stopped.line)
    done = {path: path.stat().st_mtime_ns for path in (folder / stage.out).glob(f"{parent}/*")}
    assert 1 <= len(done) <= 3
    assert not list((folder / stage.out).rglob("*.partial*"))
    assert server.run(folder, stage.command).code == 0
    assert same_as_reference(name, folder) == []
    if name == "capture":  # a run keeps its training, which takes hours, and renders its views again
        assert {path: path.stat().st_mtime_ns for path in done} == done
