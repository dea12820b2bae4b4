"""Claims about TOML and JSON files: odd numbers, types and nesting are one line that names the file."""

from pathlib import Path

import pytest

from sensor_model import PRESETS, Exposure, Sensor, read_sensor, write_sensor
from sensor_model.files.reading import brief, reading
from sensor_model.files.records import Numbers, check_shape
from sensor_model.files.toml_file import read_toml


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("a = 1" + "0" * 5000, "digit"),
        ("a = ", "not a readable TOML file"),
        ("a = '\xff'", "not UTF-8 text"),
    ],
)
def test_what_is_no_toml_is_refused_by_name(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=rf"x\.toml.*{message}"):
        read_toml(tmp_path / "x.toml")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("gain", "1" + "0" * 400), ("gain", "1e300"), ("gain", "1e-300"), ("gain", "nan"), ("sigma_d", "1e308"),
        ("sigma_d", "-inf"), ("sigma_d", "1979-05-27"), ("black_level", "1" + "0" * 400), ("bits", "true"),
        ("rgb_response", "[1" + "0" * 400 + ", 1, 1]"), ("rgb_response", "[1e-320, 1, 1]"),
        ("rgb_bias", "[nan, 0, 0]"), ("banding", "[1]"),
        ("serial", "18446744073709551616"), ("defects", "{hot_fraction = 'x'}"),
    ],
)  # fmt: skip
def test_absurd_values_of_a_camera_are_refused_with_file_and_field(field: str, value: str, tmp_path: Path) -> None:
    write_sensor(tmp_path / "c.toml", PRESETS["ideal"])
    lines = [line for line in (tmp_path / "c.toml").read_text().splitlines() if not line.startswith(f"{field} =")]
    (tmp_path / "c.toml").write_text("\n".join([f"{field} = {value}", *lines]))
    with pytest.raises(ValueError, match=rf"c\.toml.*{field}"):
        read_sensor(tmp_path / "c.toml")


def test_a_dark_current_that_doubles_without_end_is_refused() -> None:
    sensor = Sensor(gain=1.0, eta=1.0, mu_e_sat=4095.0, black_level=0.0, bits=12, dark_current=1.0, dark_doubling=1e-9)
    assert sensor.dark_e(Exposure(time=1.0)) == 1.0
    with pytest.raises(ValueError, match="less than 100 doublings above dark_temperature"):
        sensor.dark_e(Exposure(time=1.0, temperature=60.0))


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (KeyError("w"), r"f\.json is damaged \(KeyError: 'w'\); mend it"),
        (RecursionError("deep"), r"f\.json is nested too deeply; mend it"),
        (OverflowError("int"), r"f\.json holds a number that is too large; mend it"),
        (ValueError("w is bad"), r"f\.json: w is bad; mend it"),
        (ValueError("f.json: w"), r"^f\.json: w$"),
    ],
)
def test_any_failure_of_a_reader_becomes_one_that_names_the_file(error: Exception, message: str) -> None:
    with pytest.raises(ValueError, match=message), reading("f.json", "mend it"):
        raise error


@pytest.mark.parametrize("error", [OSError(28, "No space left"), MemoryError()])
def test_what_is_not_the_contents_fault_passes(error: Exception) -> None:
    with pytest.raises(type(error)), reading("f.json"):
        raise error


SHAPE = {"a": float, "b?": [int], "c?": {"*": (str, None)}, "d?": Numbers(2, 2), "e?": ({"x": int}, None)}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([], r"its content must be an object, got \[\]"),
        ({}, "a must be there, got nothing"),
        ({"a": True}, "a must be a finite number, got true"),
        ({"a": float("nan")}, "a must be a finite number, got NaN"),
        ({"a": 10**400}, "a must be a finite number, got a number of more than 30 digits"),
        ({"a": 1, "b": [1, 2.5]}, r"b\[1\] must be a whole number, got 2.5"),
        ({"a": 1, "b": [2**63]}, r"b\[0\] must be a whole number"),
        ({"a": 1, "c": {"k": 3}}, "c.k must be text or null, got 3"),
        ({"a": 1, "d": [[1, 2], [3]]}, "d must be 2 x 2 finite numbers"),
        ({"a": 1, "e": {"x": "y"}}, 'e.x must be a whole number, got "y"'),
        ({"a": 1, "e": 7}, "e must be an object or null, got 7"),
    ],
)
def test_a_value_of_another_shape_is_refused_at_its_place(value: object, message: str) -> None:
    with pytest.raises(ValueError, match=f"here: {message}.*; mend it"):
        check_shape(value, SHAPE, "here", "mend it")


def test_a_value_of_the_shape_passes_with_more_than_it_needs() -> None:
    value = {"a": 1, "b": [], "c": {"k": "s", "l": None}, "d": [[1, 2.5], [3, 4]], "e": None, "more": object()}
    check_shape(value, SHAPE, "here")


def test_what_a_file_holds_is_shown_in_one_line_of_a_stated_length() -> None:
    assert brief("short\n  and\tclean ") == "short and clean"
    shown = brief("word " * 1000, 50)
    assert len(shown) == 50
    assert shown.endswith(" ...")


def test_a_long_complaint_of_a_library_is_cut(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"x\.bin is damaged") as found, reading(tmp_path / "x.bin"):
        raise KeyError("k" * 5000)
    assert len(str(found.value)) < 500 + len(str(tmp_path))


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_toml(tmp_path / "x.toml") == {"a": 1}
