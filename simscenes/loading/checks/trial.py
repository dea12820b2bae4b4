"""A scene file is loaded in a process of its own first: a crash of Mitsuba is one line here.

There it is also shaded in the scalar variant, which refuses what the wide variants answer with 0 (`shading`).

The process stays for the next file, since it takes a second or two to start, and leaves by itself when none comes.
Files it survived are remembered by content, so that each is tried once.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib.metadata
import json
import os
import select
import signal
import subprocess
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sensor_model.files.door import reachable, read_bytes
from sensor_model.files.own import remember, remembered
from sensor_model.files.python import python
from sensor_model.files.reading import brief

FORMAT = "2"  # of the trial; scenes that passed an earlier one are tried again
SECONDS = 600.0  # that loading may take; a scene of a gigabyte takes one minute
_START = "from simscenes.loading.checks.trial_process import serve; serve()"


def check_survives(
    scene: Path, files: Sequence[Path], variant: str, parameters: Sequence[tuple[str, str]] = (), *,
    allow_outside: bool = False,
) -> None:  # fmt: skip
    """Load a scene file in another process.

    Args:
        scene: The file.
        files: All files that make up the scene, from `check_xml`.
        variant: Of Mitsuba.
        parameters: As in `SceneRef`.
        allow_outside: As in `check_xml`.

    Raises:
        ValueError: If that process crashes, hangs or refuses the scene; the reason is in the message.
    """
    more = repr((list(parameters), allow_outside)) if parameters or allow_outside else ""
    identity = _identity(files, variant) + more.encode()
    name = hashlib.sha256(identity).hexdigest()[:32]
    if remembered("scenes", name):
        return
    with _ONE_AT_A_TIME:
        problem = _PROCESSES.setdefault(variant, _Process(variant)).load(scene, parameters, allow_outside)
    if problem:
        raise ValueError(brief(problem, 600))
    remember("scenes", name)


def _identity(files: Sequence[Path], variant: str) -> bytes:
    """Content of all files with their places relative to the scene, and the code that loads them."""
    root = files[0].parent
    parts = [FORMAT, variant, *map(importlib.metadata.version, ("drjit", "mitsuba"))]
    for file in files:
        parts += [os.path.relpath(file, root), hashlib.sha256(read_bytes(file)).hexdigest()]
    return "\n".join(parts).encode()


@dataclass
class _Process:
    """A Python that loads scenes in one variant, one after the other, as `trial_process.serve` describes."""

    variant: str
    running: subprocess.Popen[bytes] | None = None

    def load(self, scene: Path, parameters: Sequence[tuple[str, str]] = (), allow_outside: bool = False) -> str:
        """Why the scene must not be loaded here; "" if nothing speaks against it."""
        try:
            # It may leave in the moment in which it is asked: then a fresh one is asked.
            asked = {"scene": str(scene), "parameters": list(parameters), "allow_outside": allow_outside}
            answer = self._ask(asked) or self._ask(asked) or "!the process that tries it ends before it answers"
        except BaseException:  # Ctrl-C: a late answer must not be taken for the answer to the next question
            self.stop()
            raise
        failed = f"scene {scene.stem!r} cannot be loaded:"
        return f"{failed} {answer[1:]}" if answer.startswith("!") else answer.removeprefix("=")

    def _ask(self, asked: dict[str, Any]) -> str:
        """The answer after a "=", the fate of the process after a "!", or "" if it had left before."""
        process = self._alive()
        assert process.stdin is not None
        assert process.stdout is not None
        request = asked | {"variant": self.variant, "cwd": str(Path.cwd()), "links": reachable()}
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            self.stop()
            return ""
        ready, _, _ = select.select([process.stdout], [], [], SECONDS)
        if not ready:
            self.stop()
            return f"!Mitsuba did not finish within {SECONDS:.0f} s"
        answer = process.stdout.readline()
        if answer.endswith(b"\n"):
            return f"={json.loads(answer)}"
        code = process.wait()
        self.stop()
        return "" if code == 0 else f"!Mitsuba crashes on it ({_reason(code)}); {HINT}"

    def _alive(self) -> subprocess.Popen[bytes]:
        if self.running is None or self.running.poll() is not None:
            self.stop()
            self.running = subprocess.Popen(
                python(_START), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is for us alone
            )  # fmt: skip
            atexit.register(self.stop)
        return self.running

    def stop(self) -> None:
        """End it, even at work."""
        if self.running is not None:
            self.running.kill()
            self.running.communicate()
            self.running = None
        atexit.unregister(self.stop)


HINT = "look for parameters that are missing or out of range, and for damaged meshes and textures"
_PROCESSES: dict[str, _Process] = {}
_ONE_AT_A_TIME = threading.Lock()


def _reason(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit status {code}"
