"""Claims about contents: hashes of values, files and folders, and JSON as it is written and read."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from novags.testbed.ledger.contents import (
    UNFINISHED,
    checksum,
    digest,
    folder_digest,
    jsonable,
    read_json,
    refuse_damage,
    shown,
    stage_key,
    write_json,
)  # fmt: skip
from sensor_model.files.records import read_once


def test_folder_digest_sees_content_and_names_but_not_costs(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.bin").write_bytes(b"1")
    write_json(tmp_path / "record.json", {"x": 1, "stage": {"seconds": 1.0}})
    before = folder_digest(tmp_path)
    write_json(tmp_path / "record.json", {"x": 1, "stage": {"seconds": 2.0}})
    (tmp_path / ".hidden").write_text("ignored")
    assert folder_digest(tmp_path) == before
    (tmp_path / "sub" / "a.bin").write_bytes(b"2")
    changed = folder_digest(tmp_path)
    (tmp_path / "sub" / "a.bin").rename(tmp_path / "sub" / "b.bin")
    assert len({before, changed, folder_digest(tmp_path)}) == 3


def test_folder_digest_follows_links_and_sees_files_elsewhere(tmp_path: Path) -> None:
    """Rationale: images often lie on another disk, behind a link or named by a path that leaves the folder."""
    (tmp_path / "far").mkdir()
    (tmp_path / "near").mkdir()
    image = tmp_path / "far" / "0.png"
    image.write_bytes(b"1")
    (tmp_path / "near" / "images").symlink_to(tmp_path / "far")

    def digests() -> set[str]:
        return {folder_digest(tmp_path / "near", ["images"]), folder_digest(tmp_path / "near", [], beside={"0": image})}

    before = digests()
    image.write_bytes(b"2")
    assert len(before | digests()) == 4


@pytest.mark.parametrize("name", [".hidden.png", "../up/0.png", UNFINISHED])
def test_folder_digest_sees_a_file_that_is_named_whatever_it_is_called(tmp_path: Path, name: str) -> None:
    image, found = tmp_path / "0.png", set()
    for content in (b"1", b"2"):
        image.write_bytes(content)
        found.add(folder_digest(tmp_path, (), beside={name: image}))
    assert len(found) == 2


def test_what_git_left_in_place_of_a_file_that_nobody_reads_is_hashed_as_it_lies_there(tmp_path: Path) -> None:
    file = tmp_path / "sparse" / "points3D.ply"
    file.parent.mkdir()
    found = set()
    for size in (1, 2):
        file.write_text(f"version https://git-lfs.github.com/spec/v1\nsize {size}\n")
        found.add(folder_digest(tmp_path, ["sparse"]))
    assert len(found) == 2


def test_folder_digest_takes_only_records_of_stages_for_records(tmp_path: Path) -> None:
    def changes(first: object, second: object) -> bool:
        seen = set()
        for value in (first, second):
            (tmp_path / "cameras.json").write_text(json.dumps(value))
            seen.add(folder_digest(tmp_path))
        return len(seen) == 2

    assert changes([{"id": 0}], [{"id": 1}])  # the cameras.json of 3DGS is a list
    assert changes({"seconds": 1.0}, {"seconds": 2.5})
    assert not changes({"stage": {}, "views": [{"seconds": 1.0}]}, {"stage": {"x": 1}, "views": [{"seconds": 2.5}]})


def test_a_file_that_was_hashed_before_is_read_again_once_it_changed(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"1")
    os.utime(path, (1e9, 1e9))
    before = folder_digest(tmp_path)
    assert folder_digest(tmp_path) == before
    path.write_bytes(b"2")
    os.utime(path, (1e9, 1e9))  # as a copy that keeps time stamps does, or a clock that was set back
    assert folder_digest(tmp_path) != before


def test_digest_ignores_key_order_and_sees_values() -> None:
    assert digest({"a": 1, "b": (2, 3)}) == digest({"b": [2, 3], "a": 1})
    assert digest({"a": 1}) != digest({"a": 2})


def test_jsonable_keeps_numbers_and_spells_out_what_json_lacks() -> None:
    value = jsonable({"inf": math.inf, "array": np.arange(3), "path": Path("a/b"), "none": None, "f": np.float32(0.5)})
    assert value == {"inf": "inf", "array": [0, 1, 2], "path": "a/b", "none": None, "f": 0.5}
    with pytest.raises(TypeError, match="object"):
        jsonable(object())


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot read"), ("{", "not valid JSON"), ("[1]", "must be an object")],
)
def test_broken_records_give_one_clear_error(tmp_path: Path, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / "r.json").write_text(content)
    with pytest.raises(ValueError, match=message):
        read_json(tmp_path / "r.json")


def test_what_is_hashed_is_what_was_parsed_whoever_writes_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("novags.testbed.ledger.hashes.time.time_ns", lambda: 1 << 62)  # every hash is remembered
    file = tmp_path / "a.json"
    file.write_text('{"a": 1}')
    before = folder_digest(tmp_path)
    with read_once({}):
        assert read_json(file) == {"a": 1}
        file.write_text('{"b": 22}')
        assert read_json(file) == {"a": 1}
        assert folder_digest(tmp_path) == before
    assert read_json(file) == {"b": 22}
    assert folder_digest(tmp_path) != before


@pytest.mark.parametrize("part", ["name", "code", "inputs", "config"])
def test_every_part_of_a_request_is_part_of_its_key_and_no_cost(part: str) -> None:
    stage = {"name": "render", "code": "c", "inputs": {"scene": "x"}, "config": {"spp": 4}, "seconds": 1.0}
    assert stage_key(stage | {"seconds": 2.0}) == stage_key(stage)
    assert stage_key(stage | {part: "another"}) != stage_key(stage)


@pytest.mark.parametrize("wrong", ["a.png", "b/c.png", "d.exr"])
def test_damage_is_seen_in_every_file_or_in_every_named_one(tmp_path: Path, wrong: str) -> None:
    names = ("a.png", "b/c.png", "d.exr")
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    stage = {"files": {name: checksum(tmp_path / name) for name in names}}
    refuse_damage(tmp_path, stage, "do it again")
    (tmp_path / wrong).write_text("another")
    others = [name for name in names if name != wrong]
    refuse_damage(tmp_path, stage, "do it again", others)
    for asked in (None, [*others, wrong], [wrong, *others]):
        with pytest.raises(ValueError, match=f"{wrong} not as written"):
            refuse_damage(tmp_path, stage, "do it again", asked)


def test_of_several_named_entries_all_files_are_shown(tmp_path: Path) -> None:
    for name in ("a/1", "a/b/2", "c", "d/3", "e"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert sorted(shown(tmp_path, ("c", "a", "d", "none"))) == ["a/1", "a/b/2", "c", "d/3"]
    assert sorted(shown(tmp_path, None)) == ["a/1", "a/b/2", "c", "d/3", "e"]
