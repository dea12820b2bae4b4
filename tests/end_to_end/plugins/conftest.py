"""A package of somebody else, as pip installs one, and a broken one beside it."""

from pathlib import Path

import pytest

PACKAGE = '''"""Four rows of somebody else."""

from dataclasses import dataclass, replace

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from novags.methods.enhanced.naive import METHOD as NAIVE
from novags.cameras import SOURCES
from simscenes.scenes import SCENES
from their_package.factor import FACTOR


@dataclass(frozen=True, kw_only=True)
class TimesConfig(EnhancerConfig):
    """Their settings."""

    factor: float = 1.0


def times(dark, config, params, noise):
    return (dark * FACTOR * config.factor).clip(0, 1), 1.0


def one(params):
    return 1.0


ENHANCER = Enhancer(TimesConfig, times, one, title="times a factor")
METHOD = by_enhancer(TimesConfig(), "times a factor", "#8c6d31", "nobody")
def room(seed):
    """Their room. It is ours."""
    return SCENES["cornell"].make(seed)


SCENE = replace(SCENES["cornell"], make=room)
'''
BROKEN = "import a_package_that_nobody_has\n"


def install(folder: Path, name: str, version: str, files: dict[str, str], points: str) -> None:
    """Put a package in a folder as pip does."""
    module = name.replace("-", "_")
    for file, text in files.items():
        path = folder / module / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    about = folder / f"{module}-{version}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (about / "entry_points.txt").write_text(points)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """The folder that both are installed in."""
    folder = tmp_path / "site"
    install(
        folder, "their-package", "1.2", {"__init__.py": PACKAGE, "factor.py": "FACTOR = 3.0\n"},
        "[novags.methods]\ntheirs = their_package:METHOD\nnaive = their_package:METHOD\n"
        "[novags.enhancers]\ntimes = their_package:ENHANCER\n[novags.scenes]\ntheir-room = their_package:SCENE\n",
    )  # fmt: skip
    install(
        folder, "broken-package", "0.1", {"__init__.py": BROKEN, "other.py": "METHOD = 3\n"},
        "[novags.methods]\nbroken = broken_package:METHOD\n[novags.cameras]\nbroken = broken_package:SOURCE\n"
        "[novags.scenes]\n../escape = broken_package:SCENE\n",
    )  # fmt: skip
    return folder
