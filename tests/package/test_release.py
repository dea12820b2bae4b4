"""scripts/release begins only where a release can come of it, and says what is in its way."""

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(
    shutil.which("bash") is None or shutil.which("git") is None, reason="scripts/release is a script for bash and git"
)
Release = Callable[..., "subprocess.CompletedProcess[str]"]


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=Somebody", "-c", "user.email=somebody@example.org")
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of one commit, which closes the changes of its version on its day."""
    monkeypatch.setenv("GIT_COMMITTER_DATE", "2031-02-03T12:00:00Z")
    folder = tmp_path / "checkout"
    (folder / "scripts").mkdir(parents=True)
    shutil.copy(ROOT / "scripts" / "release", folder / "scripts" / "release")
    (folder / ".gitignore").write_text("/dist/\n")
    (folder / "pyproject.toml").write_text('[project]\nversion = "7.1.0"\n')
    (folder / "CHANGELOG.md").write_text("# Changelog\n\n## 7.1.0, 2031-02-03\n")
    git(folder, "init", "--quiet")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "One")
    return folder


@pytest.fixture
def release(checkout: Path, tmp_path: Path) -> Release:
    """Calls the script with a Python that writes down what it is asked for, and fails."""
    stub = tmp_path / "python"
    stub.write_text(f'#!/bin/sh\necho "$@" >>{tmp_path / "asked"}\nexit 1\n')
    stub.chmod(0o755)

    def call(*words: str) -> "subprocess.CompletedProcess[str]":
        command = ["bash", str(checkout / "scripts" / "release"), *words]
        environment = {**os.environ, "NOVAGS_PYTHON": str(stub)}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    return call


def unclean(checkout: Path) -> None:
    (checkout / "forgotten.py").write_text("")


def tagged(checkout: Path) -> None:
    git(checkout, "tag", "v7.1.0")


def of_another_day(checkout: Path) -> None:
    (checkout / "CHANGELOG.md").write_text("# Changelog\n\n## 7.1.0, 2031-02-02\n")
    git(checkout, "commit", "--quiet", "--all", "--message", "Two")


def of_no_version(checkout: Path) -> None:
    (checkout / "pyproject.toml").write_text("[project]\n")
    git(checkout, "commit", "--quiet", "--all", "--message", "Two")


def built_before(checkout: Path) -> None:
    (checkout / "dist").mkdir()
    (checkout / "dist" / "novags-7.0.0.tar.gz").write_text("")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (unclean, "?? forgotten.py"), (tagged, "there is a tag v7.1.0 already"), (of_no_version, "has no line version"),
        (of_another_day, "has no heading '## 7.1.0, 2031-02-03'"), (built_before, "dist holds files already"),
    ],
)  # fmt: skip
def test_what_is_in_the_way_is_said_before_anything_is_built(
    spoil: Callable[[Path], None], said: str, checkout: Path, release: Release, tmp_path: Path
) -> None:
    spoil(checkout)
    done = release()
    assert done.returncode == 1
    assert done.stderr.startswith("[release] error: ")
    assert said in done.stderr
    assert not (tmp_path / "asked").exists()


def test_of_a_commit_whose_version_is_closed_it_builds_in_an_environment_of_its_own(
    release: Release, tmp_path: Path
) -> None:
    done = release(str(tmp_path / "elsewhere"))
    assert done.stdout.startswith("[release] building 7.1.0 of commit ")
    (asked,) = (tmp_path / "asked").read_text().splitlines()
    assert asked.startswith("-m venv ")
    assert not Path(asked.split()[-1]).parent.exists()  # its scratch is gone, though it was stopped
    assert not (tmp_path / "checkout" / "dist").exists()
