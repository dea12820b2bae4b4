"""The other end of `trial`: reads requests from standard input, answers on standard output, dies of bad scenes."""

from __future__ import annotations

import ctypes
import json
import os
import re
import resource
import select
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from sensor_model.files.door import VARIABLE

IDLE = 20.0  # s without a request after which the process ends: it holds some 200 MB
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux


def serve() -> None:
    """Answer until standard input ends or nothing is asked for a while.

    A request is a line of JSON: {"scene": path, "parameters": pairs, "allow_outside": trusted, "variant": name, "cwd":
    folder, "links": where links may lead}. So is an answer: the reason why the scene is refused, or "".
    """
    _die_with_parent()
    # Mitsuba prints to the standard output too: answers get a copy, and everything else goes nowhere.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    while select.select([sys.stdin], [], [], IDLE)[0]:
        if not (line := sys.stdin.readline()):
            break
        request = json.loads(line)
        try:
            os.chdir(request["cwd"])
            os.environ[VARIABLE] = json.dumps(request["links"])  # this process may be older than the permission
            _limit_memory()
            answer = _tried(Path(request["scene"]), request["variant"], request["parameters"], request["allow_outside"])
        except MemoryError:
            answer = f"scene {Path(request['scene']).stem!r} needs more memory than is free"
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    os._exit(0)  # without the clean-up of threads that may hang


def _tried(scene: Path, variant: str, parameters: list[list[str]], allow_outside: bool) -> str:
    from simscenes.backend import activate
    from simscenes.loading.checks.shading import check_shading
    from simscenes.loading.load import load_here
    from simscenes.loading.reference import SceneRef

    source = replace(SceneRef.of(scene), parameters=tuple((n, v) for n, v in parameters))
    mi = activate(variant)
    try:
        _look_at(load_here(source, mi, allow_outside=allow_outside).scene, mi)
        mi = activate(f"scalar_{variant.partition('_ad_')[2] or variant.removeprefix('scalar_')}")
        check_shading(load_here(source, mi, allow_outside=allow_outside).scene, mi)
    except ValueError as error:
        return str(error)
    return ""


def _look_at(scene: Any, mi: Any) -> None:
    """Trace a ray at every shape's box and shade where it arrives: damaged geometry may only show there."""
    centre, reach = scene.bbox().center(), scene.bbox().extents()
    ray = mi.Ray3f(mi.Point3f(centre + 2 * reach), mi.Vector3f(-reach))
    found = scene.ray_intersect(ray)
    str(found.p), str(found.n)


def _limit_memory() -> None:
    """Reservations beyond the memory now free fail; without this the kernel would end some process, perhaps ours."""
    try:
        used = int(re.findall(r"VmData:\s+(\d+) kB", Path("/proc/self/status").read_text())[0])
        free = int(re.findall(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())[0])
    except (OSError, IndexError):
        return  # no Linux
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    limit = (used + free) << 10
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard < 0 else min(limit, hard), hard))


def _die_with_parent() -> None:
    try:
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    except (OSError, AttributeError):
        pass  # elsewhere it ends when standard input does
