"""The rules of the house that no type checker sees: who may import whom, and what its files must not contain."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("sensor_model", "simscenes", "novags")
MITSUBA_PLACES = (
    "simscenes.backend",
    "simscenes.scenes",
    "simscenes.transport",
    "simscenes.render",
    "simscenes.loading",
    "simscenes.job",
)
# Ground floor first.
LAYERS: dict[str, tuple[tuple[str, ...], ...]] = {
    "simscenes": (
        ("rigs", "backend", "optics", "camera"),
        ("scenes", "sets"),
        ("loading",),
        ("render",),
        ("transport",),
        ("job",),
    ),
    "novags": (
        ("numbers", "process"),
        ("settings", "splats"),
        ("fields",),
        ("cameras",),
        ("methods",),
        ("warm",),
        ("testbed",),
        ("testing",),
        ("options", "failure"),
        ("commands",),
        ("interface",),
        ("cli", "__main__"),
    ),
    "novags.testbed": (
        ("metrics", "console"),
        ("ledger",),
        ("folders",),
        ("importing", "loggers"),
        ("stages",),
        ("study",),
        ("report",),
        ("site",),
        ("viewer",),
        ("flight", "dataset"),
    ),
}
FLOORS = 9  # of the test bed: as many folders as a path of imports may lead through


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules() -> dict[str, Path]:
    return {module_name(path): path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))}


@cache
def imports(name: str) -> frozenset[str]:
    """Every module that `name` imports, anywhere in the file, as absolute names."""
    path = modules()[name]
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base]) if base else ".".join(above)
            found |= {full if (full := f"{base}.{alias.name}") in modules() else base for alias in node.names}
    return frozenset(found)


def offenders(importers: list[str], forbidden: tuple[str, ...]) -> list[str]:
    return [
        f"{name} imports {target}"
        for name in importers
        for target in sorted(imports(name))
        if any(target == top or target.startswith(f"{top}.") for top in forbidden)
    ]


def inside(prefix: str) -> list[str]:
    return [name for name in modules() if name == prefix or name.startswith(f"{prefix}.")]


def test_every_package_has_modules_to_check() -> None:
    assert all(len(inside(package)) > 1 for package in PACKAGES)


@pytest.mark.parametrize(
    ("package", "forbidden"), [("sensor_model", ("simscenes", "novags")), ("simscenes", ("novags",))]
)
def test_packages_import_only_from_the_floors_below(package: str, forbidden: tuple[str, ...]) -> None:
    assert offenders(inside(package), forbidden) == []


def test_only_some_parts_of_simscenes_import_mitsuba() -> None:
    allowed = {name for place in MITSUBA_PLACES for name in inside(place)}
    assert offenders([name for name in modules() if name not in allowed], ("mitsuba", "drjit")) == []


@pytest.mark.parametrize("package", LAYERS)
def test_layers_inside_a_package_import_downwards_only(package: str) -> None:
    for floor, layer in enumerate(LAYERS[package]):
        above = tuple(f"{package}.{name}" for higher in LAYERS[package][floor + 1 :] for name in higher)
        for name in layer:
            assert offenders(inside(f"{package}.{name}"), above) == []


@pytest.mark.parametrize("package", LAYERS)
def test_every_part_of_a_package_has_a_layer(package: str) -> None:
    known = {name for layer in LAYERS[package] for name in layer}
    assert {part(name, package) for name in modules() if name.startswith(f"{package}.")} == known


def part(name: str, package: str) -> str:
    """The part of a package that a module lies in."""
    return name.removeprefix(f"{package}.").partition(".")[0]


def test_no_path_through_the_folders_of_the_testbed_is_long_or_a_circle() -> None:
    testbed = "novags.testbed"
    arrows: dict[str, set[str]] = {}
    for name in inside(testbed)[1:]:
        targets = {part(target, testbed) for target in imports(name) if target.startswith(f"{testbed}.")}
        arrows.setdefault(part(name, testbed), set()).update(targets - {part(name, testbed)})
    assert arrows["stages"] >= {"ledger", "folders"}

    def longest(folder: str, path: tuple[str, ...] = ()) -> tuple[str, ...]:
        assert folder not in path, f"a circle: {' -> '.join((*path, folder))}"
        return max((longest(other, (*path, folder)) for other in arrows.get(folder, ())), key=len,
                   default=(*path, folder))  # fmt: skip

    found = max((longest(folder) for folder in arrows), key=len)
    assert len(found) <= FLOORS, " -> ".join(found)


def test_there_are_no_import_cycles() -> None:
    graph = {name: {target for target in imports(name) if target in modules()} - {name} for name in modules()}
    while free := [name for name, targets in graph.items() if not targets & graph.keys()]:
        for name in free:
            del graph[name]
    assert not graph, f"import cycle among {sorted(graph)}"


def project_files() -> list[Path]:
    """Every file of the project, tracked or about to be; binary ones too."""
    own = (*PACKAGES, "tests", "scripts", "docs", ".ci")
    files = [path for folder in own for path in (ROOT / folder).rglob("*") if path.is_file()]
    root = [path for pattern in ("*.md", "*.toml", "*.yaml", ".gitignore", "LICENSE") for path in ROOT.glob(pattern)]
    return [path for path in (*files, *root) if path.is_file() and "__pycache__" not in path.parts]


def test_project_files_name_no_path_of_one_machine() -> None:
    # Built from parts so that this file does not match itself.
    pattern = re.compile("/" + r"(?:work|root|home|Users|tmp|var/folders)" + r"/[\w.-]+")
    found = []
    for path in project_files():
        text = path.read_text(encoding="utf-8", errors="ignore")  # of pictures what is text in them, as metadata
        found += [f"{path.relative_to(ROOT)}: {match.group()}" for match in pattern.finditer(text)]
    assert found == []


def python_files() -> list[Path]:
    return [path for path in project_files() if path.suffix == ".py"]


def test_python_files_stay_under_400_lines() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text("utf-8").splitlines()) for path in python_files()}
    assert {name: length for name, length in lengths.items() if length > 400} == {}


def test_folders_hold_few_files() -> None:
    """About a dozen: what a reader can take in at a glance. `__init__.py` and `conftest.py` count."""
    sizes = Counter(str(path.parent.relative_to(ROOT)) for path in python_files())
    assert {name: size for name, size in sizes.items() if size > 14} == {}
