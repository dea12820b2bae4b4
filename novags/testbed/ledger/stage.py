"""Stages as folders: content hashes, atomic writes, completion, resuming.

A stage writes into one folder and puts its record there last (`set.json`, `capture.json`, `run.json`, ...), so a folder
with a record is complete. The record's `stage` entry holds the key: a hash of the stage's name, its code, the contents
of its inputs and its resolved configuration. Same key: not run again. Other code, the same request: run again, and said
why. A finished result of another request is not cleared unless the caller says so. While a stage is under way,
`unfinished.json` holds the key of the work in the folder; a later start with the same key continues it, another key
clears it first. Nothing is cleared until the inputs of the new work have been read and found valid. Only one process at
a time works in a folder.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from novags.testbed.console import Console
from novags.testbed.ledger.code import Code
from novags.testbed.ledger.contents import (
    UNFINISHED,
    checksum,
    in_words,
    jsonable,
    not_as_written,
    read_digest,
    read_json,
    record_digest,
    refuse_damage,
    shown,
    stage_key,
    write_json,
)
from novags.testbed.ledger.difference import from_request, listed
from novags.testbed.ledger.made import made_name, made_with, write_made
from novags.testbed.ledger.source import hashed
from novags.testbed.machine.memory import memory_shortage_said
from novags.testbed.machine.provenance import PeakMemory, environment
from sensor_model.files.atomic import Witness, remove, witnessed
from sensor_model.files.lock import dry, locked

Prepared = TypeVar("Prepared")

STATE = {"stage?": str, "record?": str, "key?": (str, None), "seconds?": float, "peak_bytes?": int}  # what that holds
FILES = {"files?": {"*": str}}  # checksums of what the stage wrote
KEYED = {"stage?": {"key?": str, **FILES}}  # what a record of any stage holds
MADE = {"stage?": {"key?": str, "code?": str, "config?": dict, "inputs?": {"*": str}, "versions?": {"*": str}, **FILES}}

NOT_DONE = "(dry run: nothing is done)"


class Planned(Exception):
    """In a dry run: raised in place of the work, once it was said what would be done.

    Args:
        kept: Whether nothing would be.
    """

    def __init__(self, kept: bool) -> None:
        super().__init__()
        self.kept = kept


@contextmanager
def dry_run(asked: bool = True) -> Iterator[list[bool]]:
    """Where asked, a stage says what it would do, writes nothing, and ends the block; and so does `planned`.

    Yields:
        A list, to which the stage adds whether its result would be kept.
    """
    token, kept = dry.set(asked), list[bool]()
    try:
        yield kept
    except Planned as planned:
        kept.append(planned.kept)
    finally:
        dry.reset(token)


def planned(console: Console, name: str, files: Iterable[Path]) -> None:
    """In a dry run, say of each file that it would be made, or made again; otherwise do nothing.

    Call it where all has been checked and nothing is written yet.

    Args:
        console: Where it is said.
        name: What makes the files.
        files: These; what is made with each measurement, say, is said by whoever counts them.

    Raises:
        Planned: In a dry run.
    """
    if not dry.get():
        return
    for file in files:
        again, there = (" again", " is there") if file.exists() else ("", "")
        console.note(f"{name}: to be made{again} in {file.parent}: {file.name}{there} {NOT_DONE}")
    raise Planned(kept=False)


def run_stage(
    name: str,
    folder: Path,
    record_name: str,
    *,
    code: Code,
    inputs: Callable[[], Mapping[str, str]],
    opened: Mapping[str, str] | None = None,
    config: Mapping[str, Any],
    owns: Sequence[str],
    prepare: Callable[[], Prepared],
    work: Callable[[Prepared], Mapping[str, Any]],
    console: Console,
    stale: Sequence[Path] = (),
    scrap: Sequence[str] = (),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Do a stage's work unless its folder already holds the result of the same code, inputs and configuration.

    Args:
        name: What the stage is called in messages and records.
        folder: Where it writes.
        record_name: The record, written last.
        code: What does the work.
        inputs: Gives the content hash of each input, by name; asked before the work and after it.
        opened: What it gave of the inputs as they were read, where that is known; it is not asked before the work then.
        config: The resolved configuration (JSON-able).
        owns: Names in `folder` that the stage writes; nothing else is ever removed.
        prepare: Reads and checks the inputs. An earlier result stays untouched until it has returned.
        work: Fills the folder (picking up what is there) with what `prepare` read, and returns the record's body.
        console: Where progress goes.
        stale: Files elsewhere that describe an earlier result in `folder`; removed together with it.
        scrap: What in `folder` only unfinished work needs; removed once the record is written, not before.
        overwrite: Replace a finished result of other inputs or another configuration.

    Returns:
        The record, as it stands in the folder.

    Raises:
        ValueError: If `folder` holds files that no stage of this kind has written, or a finished result of another
            request, or an input is wrong.
        BlockingIOError: If another process is writing to `folder`.
        MemoryError: If there is not enough memory, of the GPU too.
    """
    with locked(folder, owns), memory_shortage_said(name):
        stage = _Stage(name, folder, record_name, code, tuple(owns), tuple(scrap), console, overwrite)
        return stage.run(inputs, jsonable(config), prepare, work, stale, opened)


def refuse_other(
    folder: Path, record_name: str, config: Mapping[str, Any], inputs: Mapping[str, str] | None = None
) -> None:
    """Refuse to replace a finished result by that of another request, or to believe one that was damaged.

    Args:
        folder: Where the request would write.
        record_name: Of the record there.
        config: The request's resolved configuration.
        inputs: Content hash of each of its inputs; None: not known yet, configurations alone count.

    Raises:
        ValueError: If `folder` holds a finished result of another one, which says what differs, or damaged files.
    """
    stage = _finished(folder, record_name)
    if stage is None:
        return
    found = from_request(stage, jsonable(config), inputs or {})
    if not found:
        refuse_damage(folder, {"stage": stage}, "add --overwrite to make it again")
    if not found and inputs is not None and "code" not in stage:
        found.append(f"made by novags {stage.get('versions', {}).get('novags')}, which recorded no code")
    if found:
        raise ValueError(
            f"{folder} holds a finished result of another request ({listed(found)}): choose another --out, or add "
            "--overwrite to replace it"
        )


def _finished(folder: Path, record_name: str) -> dict[str, Any] | None:
    """The `stage` entry of a finished result; None of an unfinished one, or while it is being replaced."""
    path, unfinished = folder / record_name, folder / UNFINISHED
    if not path.exists():
        return None
    stage: dict[str, Any] | None = read_json(path, MADE).get("stage")
    if stage is None or not unfinished.exists():
        return stage
    state = read_json(unfinished, STATE)  # of a later stage here, or left by an interruption after this one's end
    other = state.get("record", record_name) != record_name
    return stage if other or state.get("key") == stage.get("key") else None


@dataclass(frozen=True)
class _Stage:
    """A stage in its folder, which is locked."""

    name: str
    folder: Path
    record_name: str
    code: Code
    owns: tuple[str, ...]
    scrap: tuple[str, ...]
    console: Console
    overwrite: bool = False

    def run(
        self,
        ask: Callable[[], Mapping[str, str]],
        config: dict[str, Any],
        prepare: Callable[[], Prepared],
        work: Callable[[Prepared], Mapping[str, Any]],
        stale: Sequence[Path],
        opened: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """As `run_stage` says."""
        inputs = dict(ask() if opened is None else opened)
        about = {"name": self.name, "code": self.code.key, "inputs": inputs, "config": config}
        key, record_path = stage_key(about), self.folder / self.record_name
        record = read_json(record_path, KEYED) if record_path.exists() else {}
        made = record.get("stage", {}).get("key") == key
        wrong = not_as_written(self.folder, record["stage"].get("files", {})) if made else []
        if made and not wrong:
            told = made_with(self.folder, self.record_name).kept_though(self.code)
            self.console.note(f"{self.name}: unchanged, kept {self.folder}{told}")
            if dry.get():
                raise Planned(kept=True)
            self._forget_interruption()
            return record
        if not self.overwrite:
            refuse_other(self.folder, self.record_name, config, inputs)
        if wrong:
            self.console.note(f"{self.name}: {self.folder}: {in_words(wrong)}, doing it again")
        earlier = None if wrong else self._earlier_cost(key, inputs, config)  # damaged files are nothing to go on from
        if dry.get():
            self.console.note(f"{self.name}: to be made in {self.folder} {NOT_DONE}")
            raise Planned(kept=False)
        start, memory = time.perf_counter(), PeakMemory()
        prepared = prepare()
        if earlier is None:
            told_of = stale if record_path.exists() else ()
            owned = (self.record_name, made_name(self.record_name), *self.owns)
            self._clear(key, [*told_of, *(self.folder / name for name in owned)])
        before, most = earlier or (0.0, 0)
        try:
            with witnessed(read_digest) as witness:
                body = dict(work(prepared))
        except BaseException:
            with suppress(OSError):  # a full disk, say: whose work this is, is there already
                self._mark(key, before + time.perf_counter() - start, max(most, memory.peak_bytes()))
            raise
        self._refuse_changed(inputs, ask)
        files = {**self._checksums(witness), self.record_name: hashed(record_digest(body))}
        seconds = before + time.perf_counter() - start
        cost = {"seconds": seconds, "peak_bytes": max(most, memory.peak_bytes()), **environment()}
        write_made(self.folder, self.record_name, self.code)
        body["stage"] = {**about, "key": key, **cost, "files": files}
        write_json(record_path, body)
        self._tidy()
        return read_json(record_path)

    def _refuse_changed(self, inputs: Mapping[str, str], ask: Callable[[], Mapping[str, str]]) -> None:
        """Raise ValueError if an input is no longer what it was when the work began."""
        if changed := [name for name, content in ask().items() if inputs.get(name) != content]:
            self._mark(None)  # nothing here can be gone on from
            raise ValueError(
                f"{self.name}: the {' and '.join(changed)} that it reads changed while it was at work: its result in "
                f"{self.folder} is not kept; let nothing write there and run the same command again"
            )

    def _checksums(self, witness: Witness) -> dict[str, str]:
        """Of every file, as it was when this stage wrote it.

        Raises:
            ValueError: If somebody else has written to one since.
        """
        names = [name for name in self.owns if name not in (self.record_name, *self.scrap)]
        found = {}
        for name, path in sorted(shown(self.folder, names).items()):
            if (written := witness.unchanged(path)) is None:
                found[name] = checksum(path)
                written = witness.found.get(os.path.abspath(path))
                if written is not None and hashed(written) != found[name]:
                    self._mark(None)  # nothing here can be gone on from
                    raise ValueError(
                        f"{path} was changed by somebody else while {self.name} was at work: its result is not kept; "
                        "let nothing else write there and run the same command again"
                    )
            else:
                found[name] = hashed(written)
        return found

    @property
    def _unfinished(self) -> Path:
        return self.folder / UNFINISHED

    def _forget_interruption(self) -> None:
        """Work on this record was stopped after the record was written, or before anything was cleared for another."""
        if self._unfinished.exists() and read_json(self._unfinished, STATE).get("record") == self.record_name:
            self._tidy()

    def _tidy(self) -> None:
        """Remove what only unfinished work needs; what marks it goes last, so that this can be interrupted too."""
        for name in self.scrap:
            remove(self.folder / name)
        self._unfinished.unlink(missing_ok=True)

    def _why(self, stage: Mapping[str, Any], inputs: Mapping[str, str], config: Mapping[str, Any]) -> str:
        """Why a finished result is made again."""
        changed = made_with(self.folder, self.record_name).changed_in(self.code)
        found = [*from_request(stage, config, inputs), *([changed] if changed else [])]
        return listed(found) or "another stage made it"

    def _earlier_cost(self, key: str, inputs: Mapping[str, str], config: Mapping[str, Any]) -> tuple[float, int] | None:
        """Seconds of interrupted attempts at the work of `key` and the most bytes that one held.

        None if the folder has to be cleared for it.

        Raises:
            ValueError: If what is there is not this stage's.
        """
        record, name = self.folder / self.record_name, self.name
        if self._unfinished.exists():
            state = read_json(self._unfinished, STATE)
            if state.get("key") == key:
                self.console.note(f"{name}: continuing in {self.folder}")
                return float(state.get("seconds", 0.0)), int(state.get("peak_bytes", 0))
            if state.get("record", self.record_name) not in (self.record_name, *self.owns):
                raise ValueError(
                    f"{self.folder} holds unfinished work of novags {state.get('stage')}: finish that, or choose "
                    "another --out"
                )
        elif record.exists():
            if "stage" not in (found := read_json(record, MADE)):
                raise ValueError(f"{record} is there, and novags {name} did not write it: choose another --out")
            self.console.note(f"{name}: made again in {self.folder}: {self._why(found['stage'], inputs, config)}")
        elif taken := sorted(owned for owned in self.owns if (self.folder / owned).exists()):
            raise ValueError(
                f"{self.folder} already holds {', '.join(taken)}, and novags {name} did not write them: choose another "
                "--out"
            )
        return None

    def _clear(self, key: str, targets: Sequence[Path]) -> None:
        """Remove files and folders, in this order; what an interruption leaves behind belongs to no work."""
        self._mark(None)
        for target in targets:
            remove(target)
        self._mark(key)

    def _mark(self, key: str | None, seconds: float = 0.0, peak_bytes: int = 0) -> None:
        """Record whose unfinished work is in the folder; a key of None marks remains that are being cleared away."""
        state = {"stage": self.name, "record": self.record_name, "key": key, "seconds": seconds,
                 "peak_bytes": peak_bytes}  # fmt: skip
        write_json(self._unfinished, state)
