"""Claims about rows from outside: what a file or a package may say, what is refused and in which words."""

import json
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from sensor_model.files import outside
from sensor_model.files.outside import BrokenRow, Origin, Outside
from sensor_model.files.registry import Registry

GOOD = "VALUE = [1]\nPLUGIN = {'novags.methods': {'mine': VALUE}}\n"


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No file is loaded before, and none stays."""
    monkeypatch.setattr(outside, "_files", {})
    outside.once.cache_clear()
    yield
    for name in [name for name in sys.modules if name.startswith("novags_plugin_")]:
        del sys.modules[name]


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    (folder / name).write_text(text)
    return folder / name


def table() -> Registry[list]:
    return Registry({"ours": [0]}, "novags.methods", list)


def test_a_row_of_a_file_is_in_the_table_with_its_origin(tmp_path: Path) -> None:
    rows = table()
    assert list(rows) == ["ours"]
    outside.add_file(written(tmp_path, GOOD))
    assert list(rows) == ["ours", "mine"]
    assert (rows["mine"], len(rows), rows.module_of("mine")) == ([1], 2, "novags_plugin_mine")
    origin = rows.origin_of("mine")
    assert origin is not None
    assert (origin.name, len(origin.version)) == ("mine.py", 8)
    assert rows.origin_of("ours") is None
    outside.add_file(tmp_path / "mine.py")  # the same again changes nothing
    assert len(rows) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'; .* folder on PYTHONPATH"),
        ("def f(:", "SyntaxError"),
        ("raise KeyboardInterruption", "NameError"),
        ("x = 1", r'must say PLUGIN = \{"novags.methods"'),
        ("PLUGIN = {'novags.methods': [1]}", "has no such table"),
        ("PLUGIN = {'methods': {}}", "a group 'methods'; there are novags.methods"),
        ("PLUGIN = {'novags.methods': {'../up': 1}}", "a row '../up': a name has letters"),
        ("raise RuntimeError('x' * 10_000)", "RuntimeError: x{20}"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_by_name_and_leaves_nothing(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ValueError, match=rf"the plugin .*mine.py cannot be used: .*{said}") as caught:
        outside.add_file(written(tmp_path, text))
    assert len(str(caught.value)) < 600
    assert "novags_plugin_mine" not in sys.modules
    assert list(table()) == ["ours"]


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    outside.add_file(written(tmp_path, GOOD))
    with pytest.raises(ValueError, match="need names that differ"):
        outside.add_file(written(tmp_path / "other", GOOD.replace("1", "2")))


def test_a_row_of_another_kind_or_that_is_not_there_is_named_and_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    origin = Origin("their-package", "1.2")
    found = {"sys-path": Outside(origin, "sys", "path"), "none": Outside(origin, "sys", "no.such"),
             "kind": Outside(origin, "sys", "platform"), "ours": Outside(origin, "sys", "argv")}  # fmt: skip
    monkeypatch.setattr(outside, "_installed", lambda: {"novags.methods": found})
    rows = table()
    with pytest.warns(UserWarning, match="their-package 1.2 has a row 'ours' in novags.methods, as novags has"):
        assert list(rows) == ["ours", "sys-path", "none", "kind"]
    assert rows["ours"] == [0]
    with pytest.warns(UserWarning, match=r"of their-package 1.2 .*; everything else works") as warned:
        assert [*rows.items(), *rows.items()] == [("ours", [0]), ("sys-path", sys.path)] * 2
    assert len(warned) == 2  # each once
    assert list(rows.values()) == [[0], sys.path]
    with pytest.raises(BrokenRow, match=r"^sys:no.such of their-package 1.2 cannot be used \(AttributeError"):
        rows["none"]
    with pytest.raises(ValueError, match=r"sys:platform of their-package 1.2 must be of class list, got class str$"):
        rows["kind"]
    assert rows.get("none") is None  # as a row that is not there, for who can do without
    assert "none" in rows


def test_all_rows_of_all_installed_packages_are_found_and_of_two_with_one_name_one_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def point(package: str, name: str, value: str) -> SimpleNamespace:
        return SimpleNamespace(name=name, value=value, dist=SimpleNamespace(name=package, version="1"))

    points = {"novags.methods": [point("b", "two", "b.m:TWO"), point("b", "one", "b:ONE"), point("a", "one", "a:ONE")],
              "novags.scenes": [point("b", "room", "b:ROOM"), point("b", "my room", "b:ROOM")]}  # fmt: skip
    every = SimpleNamespace(select=lambda group: points.get(group, []))
    monkeypatch.setattr(outside.metadata, "entry_points", lambda: every)
    with pytest.warns(UserWarning, match="b 1 names a row") as warned:
        found = outside._installed.__wrapped__()
    rows = {group: {name: (row.origin.name, row.module, row.name) for name, row in of.items()}
            for group, of in found.items()}  # fmt: skip
    assert rows == {"novags.methods": {"one": ("a", "a", "ONE"), "two": ("b", "b.m", "TWO")},
                    "novags.scenes": {"room": ("b", "b", "ROOM")}}  # fmt: skip
    assert len(warned) == 2


def test_a_worker_gets_files_by_content_under_the_same_name(tmp_path: Path) -> None:
    text = "class Thing:\n    value = 7\nPLUGIN = {'novags.methods': {'mine': Thing()}}\n"
    outside.add_file(written(tmp_path, text))
    packed = pickle.dumps(table()["ours"]), pickle.dumps(Registry({}, "novags.methods")["mine"])
    (tmp_path / "mine.py").unlink()
    program = (
        "import pickle, sys; from sensor_model.files import outside; assert outside.arrive() is None;"
        "print(pickle.loads(bytes.fromhex(sys.argv[1])).value, outside.rows('novags.methods')['mine'].origin)"
    )
    environment = {**outside.environment(), "XDG_CACHE_HOME": str(tmp_path), "PATH": "", "HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program, packed[1].hex()], env=environment, capture_output=True,
                          text=True, check=True)  # fmt: skip
    origin = outside.rows("novags.methods")["mine"].origin
    assert done.stdout.split() == ["7", "mine.py", origin.version]


def test_files_that_are_too_large_for_workers_are_refused(tmp_path: Path) -> None:
    import random

    noise = random.Random(1).randbytes(100_000).hex()
    outside.add_file(written(tmp_path, f"{GOOD}NOISE = '{noise}'\n"))
    with pytest.raises(ValueError, match=r"the plugins mine.py have \d+ bytes packed, and workers take 90000: install"):
        outside.environment()


@pytest.mark.parametrize(
    ("there", "said"),
    [
        (None, "lacks the package json-like 1.2, whose rows are used"),
        ("1.3", "has json-like 1.3, and the rows that are used are of json-like 1.2: install the same"),
        ("content", "has it with another content"),
        ("1.2", None),
    ],
)
def test_a_node_with_another_package_is_refused_by_name(
    there: str | None, said: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def installed(version: str) -> dict[str, dict[str, Outside]]:
        return {"novags.methods": {"mine": Outside(Origin("json-like", version), "json", "loads")}}

    monkeypatch.setattr(outside, "_installed", lambda: installed("1.2"))
    for name, value in outside.environment(["json.decoder", "novags.methods"]).items():
        monkeypatch.setenv(name, value)
    if there == "content":
        monkeypatch.setattr(outside, "_content_of", lambda top: "another")
    elif there is None:
        monkeypatch.setattr(outside, "_installed", dict)
    else:
        monkeypatch.setattr(outside, "_installed", lambda: installed(there))
    why = outside.arrive()
    assert why is None if said is None else said in (why or "")


def test_without_rows_from_outside_workers_are_told_nothing() -> None:
    assert outside.environment(["novags.methods.nova.row"]) == {}
    assert outside.arrive() is None


def test_the_content_of_a_package_is_that_of_all_its_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    package = tmp_path / "several_modules_of_a_stranger"
    (package / "below").mkdir(parents=True)
    files = [package / name for name in ("__init__.py", "a.py", "below/b.py")]
    for file in files:
        file.write_text("x = 1\n")
    before = outside._content_of(package.name)
    assert before == outside._content_of(package.name)
    seen = {before}
    for file in files:
        file.write_text("x = 2\n")
        seen.add(outside._content_of(package.name))
    assert len(seen) == 4


def test_the_content_of_a_package_in_several_folders_is_that_of_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, files = "several_folders_of_a_stranger", list[Path]()
    for k in range(2):
        (tmp_path / str(k) / name).mkdir(parents=True)
        files.append(tmp_path / str(k) / name / f"part_{k}.py")
        files[-1].write_text("x = 1\n")
        monkeypatch.syspath_prepend(str(tmp_path / str(k)))
    seen = {outside._content_of(name)}
    for file in files:
        file.write_text("x = 2\n")
        seen.add(outside._content_of(name))
    assert len(seen) == 3


def test_a_worker_is_told_of_every_package_whose_rows_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {"mine": Outside(Origin("json-like", "1.2"), "json", "loads"),
            "yours": Outside(Origin("csv-like", "3"), "csv", "reader")}  # fmt: skip
    monkeypatch.setattr(outside, "_installed", lambda: {"novags.methods": rows})
    (told,) = outside.environment(["csv", "json.decoder", "novags.methods"]).values()
    assert set(json.loads(told)["packages"]) == {"csv", "json"}
