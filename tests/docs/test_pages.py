"""Claims about docs/: all pages are in the navigation, links lead somewhere, what pages show is what is printed."""

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from novags.cli import COMMANDS
from sensor_model.effect_list import EFFECT_LIST, EffectParts
from simscenes import SCENES

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))


@pytest.fixture(scope="module")
def make_docs(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("make_docs.py")


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", prose(page), re.M)
    words = (
        re.sub(r"[^\w\s-]", "", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", heading)).strip().lower() for heading in headings
    )
    return {re.sub(r"[\s-]+", "-", word) for word in words}


def test_every_page_is_in_the_navigation_once() -> None:
    listed = re.findall(r"^ +- .*?: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == [page.name for page in PAGES]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.name)
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page: Path) -> None:
    broken = []
    for target in re.findall(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)", prose(page)):  # pictures: see the site's test
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize(
    "page", [page for page in PAGES if "<!-- cheap" in page.read_text("utf-8")], ids=lambda p: p.name
)
def test_what_the_pages_show_of_cheap_commands_is_what_they_print(
    page: Path, make_docs: ModuleType, call: Callable[..., int], capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    def printed(command: str, *_: object) -> str:
        capsys.readouterr()
        assert call(*command.split()[1:]) == 0
        said = capsys.readouterr()
        return make_docs.portable(said.out + said.err, Path())

    monkeypatch.setattr(make_docs, "printed", printed)  # in this process: a new one would import all again
    text = page.read_text(encoding="utf-8")
    assert make_docs.made(text, cheap_only=True) == text, "run python scripts/make_docs.py --cheap"


def test_every_command_that_a_page_shows_has_its_output() -> None:
    empty = []
    for page in PAGES:
        for block in re.findall(r"^```console\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
            lines = block.splitlines()
            if not any(not line.startswith("$ ") for line in lines):
                empty.append(f"{page.name}: {lines[0]}")
    assert empty == [], "run python scripts/make_docs.py"


def test_the_page_of_commands_has_every_command() -> None:
    text = (DOCS / "commands.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"novags {name}" not in text] == []


PAGE = """# Page

```toml title="a.txt"
one = 1
```

<!-- file a.txt -->
```console
$ cat a.txt
old
$ pwd
```

<!-- cheap first=1 -->
```console
$ printf 'a\\nb\\n'
```

<!-- exit=3 -->
```console
$ sh -c 'echo no; exit 3'
```

```console
not a command
```
"""


def test_outputs_replace_what_is_there_and_nothing_else_changes(make_docs: ModuleType) -> None:
    made = make_docs.made(PAGE)
    assert "$ cat a.txt\none = 1\n$ pwd\n" in made
    assert re.search(r"\$ pwd\n.*novags-docs-\w+\n```", made)
    assert "$ printf 'a\\nb\\n'\na\n...\n```" in made
    assert "$ sh -c 'echo no; exit 3'\nno\n```" in made
    assert made.startswith(PAGE[: PAGE.index("$ cat")])
    cheap = make_docs.made(PAGE, cheap_only=True)
    assert cheap == PAGE.replace("$ printf 'a\\nb\\n'\n", "$ printf 'a\\nb\\n'\na\n...\n")


def test_python_is_the_one_that_runs_the_script(make_docs: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert make_docs.made("```console\n$ python -c 'print(6 * 7)'\n```\n") == (
        "```console\n$ python -c 'print(6 * 7)'\n42\n```\n"
    )


def test_a_command_that_fails_where_it_should_not_is_an_error(make_docs: ModuleType) -> None:
    with pytest.raises(RuntimeError, match="ended with 3"):
        make_docs.made("```console\n$ sh -c 'exit 3'\n```\n")


def test_the_page_of_effects_has_every_effect_of_the_camera_in_its_order() -> None:
    section = (DOCS / "what-is-simulated.md").read_text(encoding="utf-8").split("## The camera")[1].split("\n## ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    assert [name for row in rows for name in re.findall(r"`(\w+)`", row)] == [
        name for name, row in EFFECT_LIST.items() if isinstance(row, EffectParts)
    ]


@pytest.mark.parametrize("page", [*sorted(DOCS.glob("adding-*.md")), DOCS / "own-metric.md"], ids=lambda p: p.name)
def test_every_page_on_an_addition_names_the_command_that_makes_the_pages_again(page: Path) -> None:
    assert "`python scripts/make_docs.py --cheap`" in page.read_text(encoding="utf-8")


def test_the_gallery_shows_every_scene() -> None:
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert re.findall(r"^\*\*(\w+)\*\*", text, re.M) == sorted(SCENES)
    pictures = {path.stem for path in (DOCS / "gallery").iterdir()}
    assert pictures == set(SCENES)
    assert sum(path.stat().st_size for path in DOCS.rglob("*") if path.suffix in (".png", ".jpg")) < 2_500_000


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("zensical", reason="the site is built with the extra docs, which is not installed")
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    for name in ("docs", "novags", "sensor_model", "simscenes"):  # the API is read from docstrings
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site"
    assert {page.stem for page in PAGES} <= {path.stem for path in site.glob("*.html")}
    assert (site / "tables" / "table1" / "runs.csv").is_file()
    front = (site / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'<(?:script|link|img)[^>]* (?:src|href)="(?:https?:)?//[^"]*', front) == []
    assert "half a degree" in (site / "search.js").read_text(encoding="utf-8").lower()
    api = (site / "api.html").read_text(encoding="utf-8")
    assert "Cameras on an orbit around" in api  # the docstring of orbit_rig
