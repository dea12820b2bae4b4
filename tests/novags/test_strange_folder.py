"""Claims about commands in a stranger's folder: modules that lie there are not imported, whatever is computed."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.study.engines.processes import TASKS, Worker
from novags.testbed.study.engines.worker import Outcome
from novags.testbed.study.knobs.splats import in_child

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = ("json", "signal", "sitecustomize", "drjit", "mitsuba", "torch", "numba", "cv2", "numpy", "scipy", "PIL",
           "rich", "tyro", "pycolmap", "sensor_model", "simscenes")  # fmt: skip
SCENE = """<scene version="3.0.0"><shape type="sphere"/><emitter type="constant"/><sensor type="perspective">
<transform name="to_world"><lookat origin="0, -4, 1" target="0, 0, 0" up="0, 0, 1"/></transform></sensor></scene>"""


@pytest.fixture
def strange(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a scene, and modules that say when they are imported and end the process."""
    folder = tmp_path / "strange"
    folder.mkdir()
    (folder / "scene.xml").write_text(SCENE)
    for name in HOSTILE:
        said = f"open({str(tmp_path / 'ran')!r}, 'a').write('{name} ')\nimport os\nos._exit(9)\n"
        (folder / f"{name}.py").write_text(said)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # nothing has been tried before
    return folder


@pytest.fixture
def nothing_ran(tmp_path: Path) -> Callable[[], bool]:
    """A function that says whether none of the modules was imported."""
    return lambda: not (tmp_path / "ran").exists()


# As the script `novags` starts it; `python -m` imports a few modules of Python's own before anything of ours.
SCRIPT = "import sys; sys.path[0] = {0!r}; from novags.__main__ import main; main()"


def command(*words: str, path: str | None = None, module: bool = False) -> "subprocess.CompletedProcess[str]":
    start = ["-m", "novags"] if module else ["-c", SCRIPT.format(str(ROOT))]
    environment = {**os.environ, **({} if path is None else {"PYTHONPATH": path})}
    return subprocess.run(
        [sys.executable, *start, *words], capture_output=True, text=True, check=False, env=environment
    )


RENDER = ("render", "./scene.xml", "--views", "4", "--width", "16", "--height", "16", "--spp", "4", "--out", "../set")


@pytest.mark.parametrize("words", [("doctor",), RENDER], ids=["doctor", "render"])
def test_a_command_starts_no_process_that_imports_what_lies_there(
    words: tuple[str, ...], strange: Path, nothing_ran: Callable[[], bool]
) -> None:
    """Rationale: `drjit.py` beside a scene ran when a variant of Mitsuba was tried, `torch.py` in every doctor."""
    done = command(*words)
    assert nothing_ran(), done.stderr
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", [None, ":", "."])
def test_a_command_itself_imports_nothing_that_lies_there(
    path: str | None, strange: Path, nothing_ran: Callable[[], bool]
) -> None:
    """Rationale: `python -m` puts the working directory first, and an empty entry of PYTHONPATH means it."""
    if path is not None:
        for name in ("sitecustomize", "json", "signal"):  # Python imports such before anything of ours, if told so
            (strange / f"{name}.py").unlink()
    done = command("list", "methods", path=path, module=True)
    assert nothing_ran(), done.stderr
    assert done.returncode == 0, done.stderr


def test_a_worker_imports_nothing_that_lies_there(
    strange: Path, nothing_ran: Callable[[], bool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: beside a `signal.py` no worker started."""
    monkeypatch.setenv("PYTHONPATH", ":.")
    monkeypatch.setattr(sys, "path", ["", str(strange), *sys.path])
    worker = Worker.start(TASKS, {"OMP_NUM_THREADS": "1"})
    try:
        worker.give("task", {"task": None, "log": str(tmp_path / "log")}, 0.0)
        answers: list[Outcome] = [worker.connection.recv(), worker.connection.recv()]
        assert [answer.state for answer in answers] == ["ready", "failed"]  # None is no task
    finally:
        worker.ask_to_stop()
        worker.stop(0.0)
    assert nothing_ran()


def test_a_measurement_imports_nothing_that_lies_there_and_keeps_its_machine_code_elsewhere(
    strange: Path, nothing_ran: Callable[[], bool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: machine code is loaded and run; a folder of curves that somebody made may hold theirs."""
    order = {"do": "truth", "out": str(strange / "truth.npy"), "supersampled": False, "n": 20, "size": 16, "seed": 0}
    run, environments = subprocess.run, list[dict[str, str]]()

    def observed(*words: Any, env: dict[str, str], **how: Any) -> Any:
        environments.append(env)
        return run(*words, env=env, **how)

    monkeypatch.setattr(subprocess, "run", observed)
    assert isinstance(in_child(order, "default"), dict)
    assert nothing_ran()
    assert (strange / "truth.npy").exists()
    assert not (strange / "code").exists()
    kept = [Path(environment["NUMBA_CACHE_DIR"]) for environment in environments]
    assert kept == [tmp_path / "cache" / "novags" / "pareto" / "default"]
