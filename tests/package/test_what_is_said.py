"""What an installed wheel says names what is there: no page and no script that only a clone has."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from novags.cli import COMMANDS
from novags.commands.answers.topics import page
from novags.testbed.study.cells.grid import read_study
from sensor_model.files.toml_file import read_toml

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("novags", "simscenes", "sensor_model")
TEXTS = {".txt", ".html", ".js", ".css", ".toml"}
OF_A_CLONE = re.compile(r"\b(?:docs|scripts|tests)/[\w./-]*\w")


def said(package: str) -> Iterator[tuple[Path, str]]:
    """Every text of a package that can reach a user: strings, docstrings among them, and files that are no code.

    Comments are left out: those who read them have the sources.
    """
    for path in sorted((ROOT / package).rglob("*")):
        if path.suffix == ".py":
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield path, node.value
        elif path.suffix in TEXTS and path.name != "pyproject.toml":
            yield path, path.read_text(encoding="utf-8")


@pytest.mark.parametrize("package", PACKAGES)
def test_no_message_names_a_file_that_only_a_clone_has(package: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, text in said(package)
        for name in OF_A_CLONE.findall(text)
        if not any((folder / name).is_file() for folder in path.parents if folder.is_relative_to(ROOT / package))
    ]
    assert found == []


def test_every_extra_that_a_message_names_is_there() -> None:
    extras = read_toml(ROOT / "pyproject.toml")["project"]["optional-dependencies"]
    texts = [text for package in PACKAGES for _, text in said(package)]
    named = {extra for text in texts for extra in re.findall(r"novags\[([^\]]+)", text)}
    assert {"cluster", "cuda", "view"} <= named <= set(extras)


def test_the_study_of_the_help_page_is_one(tmp_path: Path) -> None:
    lines = page("studies").splitlines()
    (tmp_path / "study.toml").write_text("\n".join(line for line in lines if line.startswith("  ")))
    assert len(read_study(tmp_path / "study.toml").cells) == 18  # of 24


def test_every_command_that_a_text_quotes_is_there() -> None:
    texts = [text for package in PACKAGES for _, text in said(package)]
    quoted = {word for text in texts for word in re.findall(r"`novags ([a-z-]+)", text)}
    assert len(quoted) > 8
    assert quoted <= set(COMMANDS)
