"""scripts/setup is never silent for long."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.mark.skipif(shutil.which("bash") is None, reason="scripts/setup is a script for bash")
def test_compiling_shows_signs_of_life_as_installing_does(tmp_path: Path) -> None:
    """All is there but the kernels; twenty seconds between two lines pass in a moment."""
    sources = "novags/splats novags/methods/nova novags/methods/nova_plus novags/warm.py sensor_model/fast".split()
    for name in ("pyproject.toml", "scripts/setup", "scripts/constraints.txt", *sources):
        source, target = ROOT / name, tmp_path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
    count = "cat pyproject.toml scripts/constraints.txt | cksum"
    state = subprocess.run(["sh", "-c", count], cwd=tmp_path, capture_output=True, text=True, check=True).stdout.strip()
    program(tmp_path / ".venv/bin/python", 'case "$2" in novags.*) exec "$SLEEP" 0.5 ;; esac')
    (tmp_path / ".venv/.novags-setup").write_text(f"state {state} {tmp_path}\n")
    program(tmp_path / "bin/sleep", 'exec "$SLEEP" 0.1')
    environment = {
        **os.environ, "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}", "NOVAGS_PYTHON": sys.executable,
        "SLEEP": str(shutil.which("sleep")),
    }  # fmt: skip
    said = subprocess.run(["bash", "scripts/setup"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert "[setup] still compiling: " in said.stdout
    assert said.stdout.splitlines()[-1] == f"[setup] ready: {tmp_path / '.venv'}"
    assert "kernels " in (tmp_path / ".venv/.novags-setup").read_text()
