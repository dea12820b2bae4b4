"""Claims about what a stranger finds around the code: the package's metadata, its files, and the pages of its host."""

import re
from datetime import date
from pathlib import Path

import pytest
import yaml

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


def test_the_changelog_goes_back_day_by_day_to_this_version() -> None:
    heads = re.findall(r"^## (.*)$", read("CHANGELOG.md"), re.MULTILINE)
    assert heads[-1].startswith(f"{PROJECT['version']}, ")
    days = [date.fromisoformat(day) for day in (*heads[:-1], heads[-1].partition(", ")[2])]
    assert days == sorted(set(days), reverse=True)


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
