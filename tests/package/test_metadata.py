"""Claims about what a stranger finds around the code: the package's metadata, its files, and the pages of its host."""

import importlib
import inspect
import re
from datetime import date
from pathlib import Path

import pytest
import yaml

from novags.splats import rasterize
from sensor_model.files.toml_file import read_toml

ROOT = Path(__file__).resolve().parents[2]
TABLE = read_toml(ROOT / "pyproject.toml")
PROJECT = TABLE["project"]


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_licence_is_an_spdx_expression_whose_files_are_there() -> None:
    assert PROJECT["license"] == "Apache-2.0"
    assert not any(line.startswith("License ::") for line in PROJECT["classifiers"])  # setuptools refuses both
    assert all((ROOT / name).is_file() for name in PROJECT["license-files"])
    assert read("LICENSE").lstrip().startswith("Apache License")


@pytest.mark.parametrize("package", ["novags", "sensor_model", "simscenes"])
def test_type_checkers_of_users_read_the_annotations(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()
    assert "py.typed" in TABLE["tool"]["setuptools"]["package-data"][package]


def test_the_citation_is_of_this_version_and_of_the_paper() -> None:
    cited = yaml.safe_load(read("CITATION.cff"))
    assert cited["version"] == PROJECT["version"]
    assert cited["license"] == PROJECT["license"]
    assert cited["references"][0]["title"].startswith("NOVA-GS")


def test_the_changelog_goes_back_version_by_version_from_this_one() -> None:
    heads = re.findall(r"^## (.*)$", read("CHANGELOG.md"), re.MULTILINE)
    closed = [head.split(", ") for head in heads if head != "Unreleased"]
    assert closed[0][0] == PROJECT["version"]
    assert heads.index(", ".join(closed[0])) <= 1  # what has come since, if anything, stands above it
    days = [date.fromisoformat(day) for _, day in closed]
    assert days == sorted(days, reverse=True)


def test_names_that_the_changelog_gives_for_earlier_ones_are_there() -> None:
    entry = " ".join(
        read("CHANGELOG.md").partition("- In Python `sensor_model.Optics`")[2].partition("\n\n")[0].split()
    )
    for name, module in (
        ("SensorOptics", "sensor_model"), ("Problem", "novags.methods.problem"), ("Start", "novags.methods.problem"),
        ("Reconstruction", "novags.methods.reconstruction"),
    ):  # fmt: skip
        assert f"`{name}`" in entry
        assert hasattr(importlib.import_module(module), name)
    assert "backgrounds" in inspect.signature(rasterize).parameters


def test_forms_and_workflows_can_be_read_and_run_what_is_here() -> None:
    for path in (ROOT / ".github").rglob("*.yml"):
        assert isinstance(yaml.safe_load(path.read_text(encoding="utf-8")), dict), path
    steps = yaml.safe_load(read(".github/workflows/test.yml"))["jobs"]["test"]["steps"]
    commands = [step["run"] for step in steps if "run" in step]
    assert (ROOT / commands[-1]).is_file()
    built = yaml.safe_load(read(".readthedocs.yaml"))["build"]["commands"]
    assert any("zensical build" in command for command in built)
    assert (ROOT / "mkdocs.yml").is_file()


def test_the_image_copies_what_is_here() -> None:
    copied = [name for line in read("Dockerfile").splitlines() if line.startswith("COPY ")
              for name in line.split()[1:-1]]  # fmt: skip
    assert len(copied) > 5
    assert all((ROOT / name).exists() for name in copied)


def test_every_link_of_the_page_for_contributors_leads_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)", read("CONTRIBUTING.md"))
    assert len(links) > 8
    assert all((ROOT / link).exists() for link in links)
