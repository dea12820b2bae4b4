"""Claims about sending a data set to the hub: only whole ones, only with a token, nothing but the data set."""

import shutil
import sys
from fnmatch import fnmatch
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.dataset import pushing
from novags.testbed.dataset.pushing import push, repository
from novags.testbed.ledger.contents import read_json

QUIET = Console(quiet=True)


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A hub that notes what it is asked; signatures as in huggingface_hub 2.4.0."""
    asked: list[tuple[str, Any]] = []

    class HfApi:
        def __init__(self, *, token: str) -> None:
            asked.append(("token", token))

        def create_repo(self, repo_id: str, *, private: bool, repo_type: str, exist_ok: bool) -> None:
            asked.append(("made", (repo_id, private, repo_type, exist_ok)))

        def upload_folder(
            self, *, repo_id: str, folder_path: str, commit_message: str, repo_type: str, ignore_patterns: list[str]
        ) -> None:
            files = [path for path in Path(folder_path).rglob("*") if path.is_file()]
            names = [path.relative_to(folder_path).as_posix() for path in files]
            sent = sorted(name for name in names if not any(fnmatch(name, pattern) for pattern in ignore_patterns))
            asked.append((f"{repo_type} {repo_id}", sent))

    found = SimpleNamespace(HfApi=HfApi, get_token=lambda: "secret", asked=asked)
    monkeypatch.setitem(sys.modules, "huggingface_hub", found)  # type: ignore[arg-type]
    monkeypatch.setattr(pushing, "find_spec", lambda name: found)
    return found


@pytest.fixture
def data(finished: Any, tmp_path: Path) -> Path:
    out = Path(shutil.copytree(finished.out, tmp_path / "data"))
    (out / "making").mkdir()
    (out / "making" / "results.csv").write_text("run\n")
    (out / ".novags.lock").touch()
    return out


def test_the_data_set_and_nothing_else_is_sent(data: Path, hub: SimpleNamespace) -> None:
    said = push(data, "hf:jane/dark-1.0", QUIET)
    files = read_json(data / "manifest.json")["files"]
    assert hub.asked == [("token", "secret"), ("made", ("jane/dark-1.0", True, "dataset", True)),
                         ("dataset jane/dark-1.0", sorted([*files, "manifest.json"]))]  # fmt: skip
    assert said.startswith(f"https://huggingface.co/datasets/jane/dark-1.0: {len(files) + 1} files, ")
    assert "secret" not in said


def test_without_a_token_nothing_is_sent_and_it_says_what_is_ready(data: Path, hub: SimpleNamespace) -> None:
    hub.get_token = lambda: None
    said = push(data, "hf:jane/dark", QUIET)
    assert hub.asked == []
    assert "are ready for https://huggingface.co/datasets/jane/dark; nothing was sent" in said
    assert "HF_TOKEN" in said


def test_without_the_package_it_says_how_to_get_it(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pushing, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'novags\[hub\]'; \d+ files, .* are ready"):
        push(data, "hf:jane/dark", QUIET)


@pytest.mark.parametrize("change", ["missing", "shorter"])
def test_a_data_set_that_is_not_whole_is_not_sent(change: str, data: Path, hub: SimpleNamespace) -> None:
    file = data / "index.csv"
    file.unlink() if change == "missing" else file.write_text("view\n")
    with pytest.raises(ValueError, match=r"1 files of .* are not as its manifest\.json says: index\.csv"):
        push(data, "hf:jane/dark", QUIET)
    assert hub.asked == []


@pytest.mark.parametrize(
    "place", ["jane/dark", "hf:dark", "hf:jane/dark/more", "hf:../dark", "hf:jane/", "s3:jane/dark"]
)
def test_a_place_that_is_no_repository_is_refused_before_any_work(place: str) -> None:
    with pytest.raises(ValueError, match="--push takes hf:OWNER/NAME"):
        repository(place)
