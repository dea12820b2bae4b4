"""Settings by dotted name, from values and from text."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from novags.settings import changed, converted, files_among, flattened, has_setting, refuse_lost_files, starting_at


@dataclass(frozen=True, kw_only=True)
class Inner:
    size: int = 3
    widths: tuple[int, ...] = (1, 2)


@dataclass(frozen=True, kw_only=True)
class Outer:
    rate: float = 0.5
    count: int | None = 4
    on: bool = False
    kind: Literal["a", "b"] = "a"
    label: str = "x"
    inner: Inner = field(default_factory=Inner)
    part: Inner | None = None
    anything: Any = 0
    either: int | Literal["auto"] | Inner | None = None


@dataclass(frozen=True, kw_only=True)
class Files:
    one: Path | None = None
    several: tuple[Path, ...] = (Path("default"),)
    label: str = "x"


def test_every_value_has_a_dotted_name():
    found = flattened(Outer(part=Inner(size=9)))
    assert found["inner.size"] == 3
    assert found["part.size"] == 9
    assert found["rate"] == 0.5
    assert flattened(Outer())["part"] is None
    assert "part.size" not in flattened(Outer())


@pytest.mark.parametrize(
    ("name", "there"),
    [("rate", True), ("inner", True), ("inner.size", True), ("part", True), ("part.size", False), ("none", False),
     ("inner.none", False), ("rate.more", False)],
)  # fmt: skip
def test_a_setting_is_there_if_no_part_above_it_is_off(name, there):
    assert has_setting(Outer(), name) == there


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"rate": "0.25"}, Outer(rate=0.25)),
        ({"rate": 2}, Outer(rate=2.0)),
        ({"count": "none"}, Outer(count=None)),
        ({"count": None}, Outer(count=None)),
        ({"count": "7"}, Outer(count=7)),
        ({"on": "yes"}, Outer(on=True)),
        ({"on": True}, Outer(on=True)),
        ({"kind": "b"}, Outer(kind="b")),
        ({"label": "none such"}, Outer(label="none such")),
        ({"inner.widths": "16,32"}, Outer(inner=Inner(widths=(16, 32)))),
        ({"inner.widths": [8]}, Outer(inner=Inner(widths=(8,)))),
        ({"inner.size": 5, "inner.widths": "4", "rate": 1}, Outer(rate=1.0, inner=Inner(size=5, widths=(4,)))),
        ({"part": "default"}, Outer(part=Inner())),
        ({"part.size": "8"}, Outer(part=Inner(size=8))),
        ({"part": Inner(size=1), "part.widths": "7"}, Outer(part=Inner(size=1, widths=(7,)))),
        ({"anything": "text"}, Outer(anything="text")),
    ],
)
def test_settings_change_what_they_name_and_nothing_else(settings, expected):
    assert changed(Outer(), settings) == expected


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"rat": 1}, "has no setting 'rat'; did you mean 'rate'"),
        ({"zzzzz": 1}, "available: rate, count"),
        ({"inner.zzzzz": 1}, "Inner has no setting"),
        ({"rate": "fast"}, "setting rate must be a number, got 'fast'"),
        ({"rate": "none"}, "rate must be a number"),
        ({"count": "2.5"}, "count must be a whole number or none"),
        ({"count": 2.5}, "count must be a whole number or none"),
        ({"count": True}, "count must be a whole number"),
        ({"on": "maybe"}, "on must be true or false"),
        ({"on": 1}, "on must be true or false"),
        ({"kind": "c"}, "kind must be one of a, b"),
        ({"label": 3}, "label must be text"),
        ({"inner.widths": "1,x"}, "widths must be values separated by commas"),
        ({"rate.more": 1}, "rate is a single value"),
        ({"count.more": 1}, "count is a single value"),
        ({"inner": "wrong"}, "inner must be default, or settings of its own"),
    ],
)
def test_settings_that_do_not_fit_are_refused_by_name(settings, match):
    with pytest.raises(ValueError, match=match):
        changed(Outer(), settings)


def test_of_several_types_each_is_tried_and_named():
    assert changed(Outer(), {"either": "auto"}).either == "auto"
    assert changed(Outer(), {"either.size": 8}).either == Inner(size=8)
    said = r"either must be a whole number or one of auto or default, .* or none.*\(did you mean auto\?\)"
    with pytest.raises(ValueError, match=said):
        changed(Outer(), {"either": "atuo"})
    with pytest.raises(ValueError, match=r"size must be one of small, large, got 'smal' \(did you mean small\?\)"):
        converted("smal", Literal["small", "large"], "size")


def test_none_is_refused_where_a_part_cannot_be_off():
    assert converted("NONE", int | None, "x") is None
    with pytest.raises(ValueError, match="x must be a whole number"):
        converted("none", int, "x")


def test_files_among_settings_start_at_a_folder_and_the_rest_stays(tmp_path: Path) -> None:
    given = {"one": "a.pt", "label": "b.pt"}
    config = changed(Files(), given)
    assert files_among(config) == {"one": (Path("a.pt"),), "several": (Path("default"),)}
    assert starting_at(tmp_path, given, config) == {"one": str(tmp_path / "a.pt"), "label": "b.pt"}
    more = changed(Files(), {"several": "a,/b"})
    assert starting_at(tmp_path, {"several": "a,/b"}, more) == {"several": [str(tmp_path / "a"), "/b"]}


def test_a_file_that_is_not_there_is_named_with_its_setting(tmp_path: Path) -> None:
    (tmp_path / "default").touch()
    there = Files(several=(tmp_path / "default",))
    refuse_lost_files(there, "mine")
    with pytest.raises(ValueError, match=r"^mine: one is .*gone, but that file does not exist"):
        refuse_lost_files(changed(there, {"one": str(tmp_path / "gone")}), "mine")
    several = changed(there, {"several": f"{tmp_path / 'default'},{tmp_path / 'lost'}"})
    with pytest.raises(ValueError, match=r"^mine: several is .*lost, but that file does not exist"):
        refuse_lost_files(several, "mine")


def test_a_list_in_text_has_all_its_parts():
    assert changed(Outer(), {"inner.widths": "3,4,5"}).inner.widths == (3, 4, 5)
    assert changed(Outer(), {"inner.widths": [3, 4, 5]}).inner.widths == (3, 4, 5)
