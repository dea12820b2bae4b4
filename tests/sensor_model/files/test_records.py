"""Claims about what is parsed: JSON and TOML of bounded depth and numbers, and the place of what is wrong."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensor_model.files.records import DEPTH, check_depth, check_shape, parse_json, read_json
from sensor_model.files.toml_file import read_toml

PLAIN = st.recursive(
    st.none() | st.booleans() | st.text() | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)  # fmt: skip


@given(PLAIN)
def test_whatever_json_writes_is_read_back(value: Any) -> None:
    assert parse_json(json.dumps(value), "x.json") == value


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 100_000, "is nested too deeply"),
        ('{"a":' * 100_000, "is nested too deeply"),
        ("[" * (DEPTH + 1) + "]" * (DEPTH + 1), f"nested more than {DEPTH} deep"),
        ('{"a":' * (DEPTH + 1) + "1" + "}" * (DEPTH + 1), f"nested more than {DEPTH} deep"),
        ("9" * 400, "below 2\\*\\*64, got one of 400 digits"),
        ("9" * 5000, "below 2\\*\\*64, got one of 5000 digits"),
        (str(2**64), "below 2\\*\\*64"),
        (str(-(2**64)), "below 2\\*\\*64"),
        ("1e999", "below 1.8e308, got 1e999"),
        ("-1e400", "below 1.8e308"),
        ("NaN", "must be finite, got NaN"),
        ('{"a": [-Infinity]}', "must be finite, got -Infinity"),
        ('{"a": 1, "b": 2, "a": 1}', "'a' stands twice"),
        ('{"o": {"\\u0061": 1, "a": 1}}', "'a' stands twice"),
        ('{"a": 1', "not valid JSON"),
        ("", "not valid JSON"),
    ],
)
def test_json_that_readers_go_wrong_on_is_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "set.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=reason) as refused:
        read_json(path)
    assert "set.json" in str(refused.value)
    assert len(str(refused.value)) < 400
    assert "\n" not in str(refused.value)


def test_depth_and_numbers_up_to_the_bounds_are_read() -> None:
    deep: Any = 1
    for i in range(DEPTH):
        deep = [deep] if i % 2 else {"a": deep}
    assert parse_json(json.dumps(deep), "x") == deep
    assert parse_json(f"[{2**64 - 1}, {1 - 2**64}, 1.7e308, 1e-999]", "x") == [2**64 - 1, 1 - 2**64, 1.7e308, 0.0]


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_json_and_toml_are_read_with_and_without_a_byte_order_mark(tmp_path: Path, mark: bytes) -> None:
    (tmp_path / "a.json").write_bytes(mark + b'{"a": 1}\r\n')
    (tmp_path / "a.toml").write_bytes(mark + b"a = 1\r\n")
    assert read_json(tmp_path / "a.json") == read_toml(tmp_path / "a.toml") == {"a": 1}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a = nan", "a must be a number, got nan"),
        ("[t]\na = [1.0, -nan]", r"t.a\[1\] must be a number, got nan"),
        (f"a = {2**64}", r"a must be below 2\*\*64"),
        (f"a = {'9' * 400}", r"a must be below 2\*\*64"),
        (f"a = {'9' * 5000}", "a.toml"),
        (f"a = {'[' * 5000}{']' * 5000}", "is nested too deeply"),
        (f"a = {'[' * (DEPTH + 1)}{']' * (DEPTH + 1)}", f"nested more than {DEPTH} deep"),
        ("a = 1\na = 2", "not a readable TOML file"),
    ],
)
def test_toml_that_readers_go_wrong_on_is_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=reason) as refused:
        read_toml(path)
    assert "a.toml" in str(refused.value)
    assert len(str(refused.value)) < 400
    assert "\n" not in str(refused.value)


def test_infinity_in_toml_is_left_to_its_reader(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(f"mu_e_sat = inf\nserial = {2**64 - 1}")
    assert read_toml(tmp_path / "a.toml") == {"mu_e_sat": float("inf"), "serial": 2**64 - 1}


SHAPE: Any = {"name": str, "sizes": [int], "scores": {"*": float}, "note?": str}
WHOLE: dict[str, Any] = {"name": "a", "sizes": [1, 2, 3], "scores": {"x": 0.5, "y": 2}}


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"sizes": [1, 2.5, 3]}, "sizes[1]"), ({"sizes": [1, 2, True]}, "sizes[2]"),
        ({"scores": {"x": 0.5, "y": "2"}}, "scores.y"), ({"scores": {"x": "0.5", "y": 2}}, "scores.x"),
        ({"note": 3}, "note"), ({"name": None}, "name"),
    ],
)  # fmt: skip
def test_whatever_part_has_another_shape_is_named(changes: dict[str, Any], place: str) -> None:
    check_shape(WHOLE, SHAPE, "x.json")
    check_shape(WHOLE | {"note": "b"}, SHAPE, "x.json")
    with pytest.raises(ValueError, match=rf"x\.json.*{re.escape(place)}"):
        check_shape(WHOLE | changes, SHAPE, "x.json")


@pytest.mark.parametrize("kind", ["list", "object"])
def test_what_is_nested_too_deeply_beside_flat_parts_is_refused(kind: str) -> None:
    deep: Any = 0
    for _ in range(DEPTH - 1):
        deep = [1, [], deep] if kind == "list" else {"a": 1, "b": {}, "c": deep}
    check_depth(deep)
    with pytest.raises(ValueError, match=f"nested more than {DEPTH} deep"):
        check_depth([[], deep])


@pytest.mark.parametrize("names", ["abcc", "ccab", "cac", "caac"])
def test_a_name_that_stands_twice_among_others_is_said(names: str) -> None:
    with pytest.raises(ValueError, match="'c' stands twice in one object"):
        parse_json("{" + ", ".join(f'"{name}": 1' for name in names) + "}", "x.json")
