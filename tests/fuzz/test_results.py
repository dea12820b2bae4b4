"""The harness notices wrong results, whatever stands in the place of a file, and what a command may not do."""

import json
import os
import random
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from tests.fuzz.case import DAMAGE, Cases, Reader  # noqa: E402
from tests.fuzz.damage import places, texts  # noqa: E402
from tests.fuzz.damage.tree import Tree  # noqa: E402
from tests.fuzz.digest import digest  # noqa: E402


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """What the harness finds in readers and commands with known faults; in a process of its own, since it forks."""
    words = [sys.executable, "-m", "tests.fuzz.planted_results"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("reader", "wanted"),
    [
        ("right", {}),
        ("anything", {"FIFO": "hang", "device zero": "memory", "sparse": "memory", "link outside": "wrong",
                      "byte-order mark": "wrong", "CRLF": "wrong", "other order": "wrong"}),
        ("mark_read", {"byte-order mark": "wrong", "CRLF": "wrong", "other order": "wrong"}),
        ("order_kept", {"other order": "wrong"}),
        ("no_links", {"link inside": "wrong", "link outside, allowed": "wrong"}),
    ],
)  # fmt: skip
def test_a_reader_is_blamed_for_what_it_makes_of_odd_files(
    found: dict[str, Any], reader: str, wanted: dict[str, str]
) -> None:
    told = {f["file"].removeprefix("a.json (").removesuffix(")"): f["kind"] for f in found["readers"][reader]}
    assert told == wanted


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ("overwrite", "overwritten"), ("new file", "overwritten"), ("escape", "control"), ("shout", "message"),
        ("silent", "message"), ("warn", "warning"), ("execute", "executed"), ("fail", "exception"), ("fill", "memory"),
        ("leave", "exit"), ("crash", "crash"), ("wait", "hang"), ("refuse", "wrong"), ("end a link", "wrong"),
        ("right", None),
    ],
)  # fmt: skip
def test_a_command_is_blamed_for_what_none_may_do(found: dict[str, Any], command: str, kind: str | None) -> None:
    fault = found["commands"][command]
    assert (fault and fault[0]) == kind


@pytest.mark.parametrize("kind", sorted(places.RULE))
def test_what_stands_in_a_files_place_is_of_its_kind_and_goes_without_a_trace(kind: str, tmp_path: Path) -> None:
    root, outside = tmp_path / "root", tmp_path / "outside"
    valid = Tree({"a/b.bin": b"x" * 9, "c.bin": b"y"}, ("a",))
    valid.restore(root)
    before = (root / "a/b.bin").stat()
    with places.standing(kind, root, "a/b.bin", outside):
        path = root / ("a" if kind in places.OF_FOLDERS else "a/b.bin")
        there = os.path.lexists(path)
        mode = path.lstat().st_mode if there else 0
        assert there == (kind != "missing")
        assert stat.S_ISLNK(mode) == ("link" in kind or kind.startswith("device"))
        assert stat.S_ISFIFO(mode) == kind.startswith("FIFO")
        assert kind != "sparse" or (path.stat().st_size, path.stat().st_blocks * 512 < 1 << 20) == (1 << 40, True)
    assert Tree.of(root) == valid
    assert (root / "a/b.bin").stat().st_ino == before.st_ino
    if there:
        (outside / "left").write_bytes(b"x")
        places.put(kind, root / "left", outside / "left", root, outside)  # as where a child dies
        valid.restore(root)
        assert Tree.of(root) == valid


JSON = json.dumps({"a": 1.5, "b": [{"name": "x", "n": 2}]}, indent=1).encode()


def test_texts_that_mean_the_same_hold_the_same_values() -> None:
    rng = random.Random(0)
    for kind in texts.SAME:
        assert json.loads(texts.changed(kind, "a.json", JSON, rng).decode("utf-8-sig")) == json.loads(JSON)
    assert texts.changed("CRLF", "a.json", JSON, rng).count(b"\r\n") == JSON.count(b"\n")


@pytest.mark.parametrize("file", ["a.json", "a.jsonl", "a.toml", "a.xml", "a.txt", "a.ply"])
@pytest.mark.parametrize("kind", texts.OTHER)
def test_odd_texts_are_made_of_every_kind_of_file(file: str, kind: str) -> None:
    content = {"a.toml": b'a = 1.5\nb = "x"\n', "a.xml": b'<scene version="3"><x name="y"/></scene>',
               "a.txt": b"1 2.5 name\n", "a.ply": b"ply\nelement vertex 3\nend_header\n"}.get(file, JSON)  # fmt: skip
    content = content.replace(b"\n", b"") + b"\n" if file == "a.jsonl" else content
    made = [texts.changed(kind, file, content, random.Random(k)) for k in range(20)]
    assert made == [texts.changed(kind, file, content, random.Random(k)) for k in range(20)]
    assert sum(each != content for each in made) >= 15
    assert kind != "deep" or max(map(len, made)) > texts.DEPTH


def test_new_kinds_are_a_share_of_the_cases_and_damage_stays_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(JSON)
    reader = Reader("r", lambda f: None, lambda f, p: None, ("*.json",))
    old = Reader("r", lambda f: None, lambda f, p: None, ("*.json",), placed=False, odd=False)
    cases, before = Cases.of(reader, tmp_path, 0), Cases.of(old, tmp_path, 0)
    kinds = [cases.case(k).kind for k in range(1000)]
    assert 250 < sum(kind != DAMAGE for kind in kinds) < 350
    assert {*places.RULE, *texts.SAME, *texts.OTHER} - set(kinds) == set(places.OF_FOLDERS)  # it lies in none
    assert all(cases.case(k) == before.case(k) for k in range(1000) if kinds[k] == DAMAGE)


def test_digests_tell_results_apart_but_not_places_and_orders() -> None:
    import numpy as np

    assert digest({"a": 1, "b": Path("x")}) == digest({"b": Path("y"), "a": 1})
    assert digest([np.zeros(3)]) == digest([np.zeros(3)])
    different = [None, 0, 0.0, -0.0, False, "0", b"0", [0], (0,), {0: 0}, np.zeros(1), np.zeros(1, np.float32),
                 np.zeros((1, 1)), np.ones(1), float("nan")]  # fmt: skip
    assert len({digest(value) for value in different}) == len(different)
