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
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from novags.testbed.console.memory import memory_shortage_said
from novags.testbed.console.provenance import PeakMemory, environment
from novags.testbed.console.terminal import Console
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
from novags.testbed.ledger.dry import NOT_DONE, Planned
from novags.testbed.ledger.made import made_name, made_with, write_made
from novags.testbed.ledger.same import taken_over
from novags.testbed.ledger.source import hashed
from sensor_model.files.atomic import Witness, remove, witnessed
from sensor_model.files.lock import dry, locked

Prepared = TypeVar("Prepared")

STATE = {"stage?": str, "record?": str, "key?": (str, None), "seconds?": float, "peak_bytes?": int}  # what that holds
MADE = {"stage?": {"key?": str, "code?": str, "config?": dict, "inputs?": {"*": str}, "versions?": {"*": str},
                   "files?": {"*": str}}}  # a record of any stage  # fmt: skip


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
        name: The stage's name in messages and records.
        folder: Where it writes.
        record_name: The record, written last.
        code: The code that does the work.
        inputs: Gives the content hash of each input, by name; asked before the work and after it.
        opened: Its result for the inputs at the time of reading, where that is known; it is not asked before the work
            then.
        config: The resolved configuration (JSON-able).
        owns: Names in `folder` that the stage writes; nothing else is ever removed.
        prepare: Reads and checks the inputs. An earlier result stays untouched until it has returned.
        work: Fills the folder (picking up existing files) from the data that `prepare` read, and returns the record's
            body.
        console: Where progress goes.
        stale: Files elsewhere that describe an earlier result in `folder`; removed together with it.
        scrap: Files in `folder` that only unfinished work needs; removed once the record is written, not before.
        overwrite: Replace a finished result of other inputs or another configuration.

    Returns:
        The record in the folder.

    Raises:
        ValueError: If `folder` holds files that no stage of this kind has written, or a finished result of another
            request, or an input is wrong.
        BlockingIOError: If another process is writing to `folder`.
        MemoryError: If there is not enough memory, of the GPU too.
    """
    with locked(folder, owns), memory_shortage_said(name):
        stage = _Stage(name, folder, record_name, code, tuple(owns), tuple(scrap), console)
        known = dict(inputs() if opened is None else opened)
        asked = {"name": name, "code": code.key, "inputs": known, "config": jsonable(config)}
        asked["key"] = stage_key(asked)
        record = folder / record_name
        if not stage.begun() and (other := taken_over(folder, record_name, asked["key"])):
            console.note(f"{name}: taken from {other}, which is made from equal contents")
        made = read_json(record, MADE) if record.exists() else {}
        current = made.get("stage", {}).get("key") == asked["key"]
        wrong = not_as_written(folder, made["stage"].get("files", {})) if current else []
        if current and not wrong:
            stage.keep()
            return made
        if not overwrite:
            refuse_other(folder, record_name, config, known)
        if wrong:
            console.note(f"{name}: {folder}: {in_words(wrong)}, doing it again")
        earlier = None if wrong else stage.earlier_cost(asked)  # damaged files are nothing to go on from
        if dry.get():
            console.note(f"{name}: to be made in {folder} {NOT_DONE}")
            raise Planned(kept=False)
        return stage.make(asked, inputs, prepare, work, earlier, stale)


def refuse_other(
    folder: Path, record_name: str, config: Mapping[str, Any], inputs: Mapping[str, str] | None = None
) -> None:
    """Refuse to replace a finished result by another request's, or to believe a damaged one.

    Args:
        folder: Where the request would write.
        record_name: Of the record there.
        config: The request's resolved configuration.
        inputs: Content hash of each of its inputs; None: not known yet, configurations alone count.

    Raises:
        ValueError: If `folder` holds a finished result of another one, which names the differences, or damaged files.
    """
    stage = _finished(folder, record_name)
    if stage is None:
        return
    found = from_request(stage, jsonable(config), inputs or {})
    if not found:
        refuse_damage(folder, stage, "add --overwrite to make it again")
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

    def keep(self) -> None:
        """Say that the result there stays.

        Raises:
            Planned: In a dry run.
        """
        told = made_with(self.folder, self.record_name).kept_though(self.code)
        self.console.note(f"{self.name}: unchanged, kept {self.folder}{told}")
        if dry.get():
            raise Planned(kept=True)
        # Work on this record may have been stopped after it was written, or before anything was cleared for another.
        if self._unfinished.exists() and read_json(self._unfinished, STATE).get("record") == self.record_name:
            self._tidy()

    def make(
        self, asked: dict[str, Any], ask: Callable[[], Mapping[str, str]], prepare: Callable[[], Prepared],
        work: Callable[[Prepared], Mapping[str, Any]], earlier: tuple[float, int] | None, stale: Sequence[Path],
    ) -> dict[str, Any]:  # fmt: skip
        """Do the work and write the record; `asked`: its entry "stage", except the findings and costs of the work."""
        start, memory, record_path = time.perf_counter(), PeakMemory(), self.folder / self.record_name
        prepared = prepare()
        if earlier is None:
            told_of = stale if record_path.exists() else ()
            owned = (self.record_name, made_name(self.record_name), *self.owns)
            self._clear(asked["key"], [*told_of, *(self.folder / name for name in owned)])
        before, most = earlier or (0.0, 0)

        def cost() -> dict[str, Any]:
            return {"seconds": before + time.perf_counter() - start, "peak_bytes": max(most, memory.peak_bytes())}

        try:
            with witnessed(read_digest) as witness:
                body = dict(work(prepared))
        except BaseException:
            with suppress(OSError):  # a full disk, say: whose work this is, is there already
                self._mark(asked["key"], **cost())
            raise
        if changed := [name for name, content in ask().items() if asked["inputs"].get(name) != content]:
            self._refuse(f"the {' and '.join(changed)} that it reads")
        files = {**self._checksums(witness), self.record_name: hashed(record_digest(body))}
        write_made(self.folder, self.record_name, self.code)
        made_by = environment(self.code.outside)
        write_json(record_path, {**body, "stage": {**asked, **cost(), **made_by, "files": files}})
        self._tidy()
        return read_json(record_path)

    def _refuse(self, what: str) -> None:
        """Raise ValueError, because something was changed by somebody else; nothing here can be gone on from."""
        self._mark(None)
        raise ValueError(
            f"{self.name}: {what} changed while it was at work: its result in {self.folder} is not kept; let nothing "
            "else write there and run the same command again"
        )

    def _checksums(self, witness: Witness) -> dict[str, str]:
        """Of every file, at the time when this stage wrote it.

        Raises:
            ValueError: If somebody else has written to one since.
        """
        names = [name for name in self.owns if name not in (self.record_name, *self.scrap)]
        found = {}
        for name, path in sorted(shown(self.folder, names).items()):
            written = witness.unchanged(path)
            found[name] = checksum(path) if written is None else hashed(written)
            before = witness.found.get(os.path.abspath(path))
            if before is not None and hashed(before) != found[name]:
                self._refuse(f"{path}, which it wrote, was")
        return found

    def begun(self) -> bool:
        """Whether anything of this stage is there."""
        return any((self.folder / name).exists() for name in (UNFINISHED, self.record_name, *self.owns))

    @property
    def _unfinished(self) -> Path:
        return self.folder / UNFINISHED

    def _tidy(self) -> None:
        """Remove files that only unfinished work needs; its mark goes last, so that this can be interrupted too."""
        for name in self.scrap:
            remove(self.folder / name)
        self._unfinished.unlink(missing_ok=True)

    def earlier_cost(self, asked: Mapping[str, Any]) -> tuple[float, int] | None:
        """Seconds of interrupted attempts at this work and the most bytes that one held.

        None if the folder has to be cleared for it.

        Raises:
            ValueError: If the existing files are not this stage's.
        """
        record, name = self.folder / self.record_name, self.name
        if self._unfinished.exists():
            state = read_json(self._unfinished, STATE)
            if state.get("key") == asked["key"]:
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
            changed = made_with(self.folder, self.record_name).changed_in(self.code)
            why = [*from_request(found["stage"], asked["config"], asked["inputs"]), *([changed] if changed else [])]
            self.console.note(f"{name}: made again in {self.folder}: {listed(why) or 'another stage made it'}")
        elif taken := sorted(owned for owned in self.owns if (self.folder / owned).exists()):
            raise ValueError(
                f"{self.folder} already holds {', '.join(taken)}, and novags {name} did not write them: choose another "
                "--out"
            )
        return None

    def _clear(self, key: str, targets: Sequence[Path]) -> None:
        """Remove files and folders, in this order; leftovers of an interruption belong to no work."""
        self._mark(None)
        for target in targets:
            remove(target)
        self._mark(key)

    def _mark(self, key: str | None, seconds: float = 0.0, peak_bytes: int = 0) -> None:
        """Record whose unfinished work is in the folder; a key of None marks remains that are being cleared away."""
        state = {"stage": self.name, "record": self.record_name, "key": key, "seconds": seconds,
                 "peak_bytes": peak_bytes}  # fmt: skip
        write_json(self._unfinished, state)
