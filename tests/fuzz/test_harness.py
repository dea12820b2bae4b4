"""The harness notices every kind of fault, blames the right case, and damages files as it says."""

import json
import os
import subprocess
import sys
from pathlib import Path
from random import Random
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))  # where pytest is started by itself and not as a module

from tests.fuzz.case import Cases, Reader  # noqa: E402
from tests.fuzz.damage import mutate, structure  # noqa: E402


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    """What the harness finds in readers with known faults; in a process of its own, since it forks."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.planted"], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("fault", "kind", "detail"),
    [
        ("segfault", "crash", "SIGSEGV"),
        ("abort", "crash", "SIGABRT"),
        ("leave", "crash", "exit status 0"),
        ("hang", "hang", "not finished after 1 s"),
        ("wait", "hang", "not finished after 1 s"),
        ("one_large_block", "memory", "MemoryError"),
        ("many_small_blocks", "memory", "MemoryError"),
        ("memory_behind_a_documented_error", "memory", "ValueError: the file cannot be read"),
        ("undocumented", "exception", "KeyError: 'frames'"),
        ("recursion", "exception", "RecursionError"),
        ("stop", "exception", "KeyboardInterrupt"),
        ("warning", "warning", "RuntimeWarning: invalid value"),
        ("silence", "message", "ValueError of 0 characters"),
        ("flood", "message", "ValueError of 10000 characters"),
    ],
)
def test_each_fault_is_found_and_blamed_on_its_case(found: dict[str, Any], fault: str, kind: str, detail: str) -> None:
    assert [(f["case"], f["kind"]) for f in found[fault]] == [(1, kind)]
    assert detail in found[fault][0]["detail"]


def test_a_death_that_needs_earlier_cases_says_so(found: dict[str, Any]) -> None:
    (finding,) = found["only_after_others"]
    assert (finding["case"], finding["kind"]) == (2, "crash")
    assert "not alone, after cases from 0 on" in finding["detail"]


def test_documented_errors_and_notes_to_the_user_are_no_findings(found: dict[str, Any]) -> None:
    assert found["documented"] == []


SAMPLES = {
    "a.json": json.dumps({"w": 3, "frames": [{"file_path": "a", "transform_matrix": [[1.0, 2], [3, 4]]}]}).encode(),
    "a.jsonl": b'{"l1": 0.5}\n{"l1": 0.25}\n',
    "a.toml": b'gain = 1.5\n[optics]\nf = 2\nname = "x"\n',
    "a.xml": b'<scene version="3.0.0"><shape type="sphere"><float name="radius" value="2"/></shape></scene>',
    "a.argv": json.dumps(["render", "cornell", "--out", "set"]).encode(),
    "a.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nend_header\n\0\0\0\0",
    "a.bin": bytes(range(200)),
}


@pytest.mark.parametrize("name", [*SAMPLES, "a.png", "a.pt", "a.safetensors"])
def test_damage_is_frequent_repeatable_and_stands_any_input(name: str) -> None:
    content = SAMPLES.get(name, SAMPLES["a.bin"])
    made = [mutate.damaged(name, content, Random(f"{k}")) for k in range(200)]
    assert made == [mutate.damaged(name, content, Random(f"{k}")) for k in range(200)]
    assert sum(damaged != content for damaged in made) > 150
    assert len(set(made)) > 50
    for k in range(50):  # damage to what damage left
        mutate.damaged(name, made[k], Random(f"again {k}"))
    assert mutate.damaged(name, b"", Random("0")) is not None


def test_damage_to_a_structure_keeps_its_form() -> None:
    parsed = 0
    for k in range(200):
        text = structure.json_value(SAMPLES["a.json"], Random(f"{k}"))
        try:
            json.loads(text)
        except (ValueError, RecursionError):
            continue
        parsed += 1
    assert parsed > 150


def test_a_chunk_of_a_png_keeps_a_sum_that_fits() -> None:
    import struct
    import zlib

    chunk = b"IHDR" + struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    changed = [structure.png_chunk(png, Random(f"{k}")) for k in range(60)]
    heads = [(c[12:29], c[29:33]) for c in changed if len(c) == len(png)]
    assert len(heads) > 20
    assert len(set(heads)) > 10
    assert all(zlib.crc32(head) == struct.unpack(">I", end)[0] for head, end in heads)


def test_files_are_cut_at_every_offset_and_whole_cases_come_first(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"abcde")
    (tmp_path / "b.txt").write_bytes(b"text")
    reader = Reader(
        "r", lambda f: None, lambda f, p: None, ("*.bin", "*.txt"), cut=("*.bin",), also=lambda: [("c.xml", b"<x/>")]
    )
    cases = Cases.of(reader, tmp_path, 0)
    first = [cases.case(k)[:2] for k in cases.chosen(40)[:6]]
    assert first == [("c.xml", b"<x/>"), *(("a.bin", b"abcde"[:n]) for n in range(5))]
    assert len(cases.chosen(40)) == len(set(cases.chosen(40))) == 40
    assert {cases.case(k)[0] for k in cases.chosen(40)} == {"a.bin", "b.txt", "c.xml"}
    assert [cases.case(k)[1] for k in cases.chosen(40)] != [
        Cases.of(reader, tmp_path, 1).case(k)[1] for k in cases.chosen(40)
    ]
    spread = cases.chosen(4)  # fewer than there are: not only the first offsets
    assert spread[:2] == [0, 3]
    assert os.listdir(tmp_path)
