"""Settings by dotted name, from values and from text; methods and variants by name."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from novags import methods
from novags.methods.variant import Variant, parse_variant
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


def test_none_is_refused_where_a_part_cannot_be_off():
    assert converted("NONE", int | None, "x") is None
    with pytest.raises(ValueError, match="x must be a whole number"):
        converted("none", int, "x")


@pytest.mark.parametrize(
    ("text", "variant"),
    [
        ("calm=nova:sh_weight=none", Variant(name="calm", method="nova", settings={"sh_weight": "none"})),
        ("a=naive:x=1,y=2", Variant(name="a", method="naive", settings={"x": "1", "y": "2"})),
        ("a=naive:x=1,2,3;y=2", Variant(name="a", method="naive", settings={"x": "1,2,3", "y": "2"})),
        ("a=naive:x=1,2,y=3", Variant(name="a", method="naive", settings={"x": "1,2", "y": "3"})),
        (" a = naive :x= 1 ", Variant(name="a", method="naive", settings={"x": "1"})),
        ("other=nova", Variant(name="other", method="nova")),
    ],
)
def test_a_variant_is_a_name_a_method_and_settings(text, variant):
    assert parse_variant(text) == variant


@pytest.mark.parametrize(
    ("text", "match"),
    [("nova", "a variant is NAME"), ("=nova", "letters, digits"), ("a=", "a variant is NAME"),
     ("a=nova:", "a variant is NAME"), ("a=nova:x", "each setting"), ("a=nova:x=", "each setting"),
     ("a=nova:=1", "each setting"), ("../a=nova", "letters, digits")],
)  # fmt: skip
def test_other_texts_are_no_variants(text, match):
    with pytest.raises(ValueError, match=match):
        parse_variant(text)


def test_a_variants_own_settings_win_over_shared_ones_and_those_of_a_part_that_is_off_are_passed_over():
    shared = {"rate": 0.1, "inner.size": 7, "not.there": 1, "label": "s"}
    assert Variant(name="v", method="m", settings={"rate": 0.9}).config(Outer(), shared) == Outer(
        rate=0.9, inner=Inner(size=7), label="s"
    )
    off = Variant(name="v", method="m", settings={"part": None})
    assert off.config(Outer(part=Inner()), {"part.size": 8}) == Outer(part=None)
    with pytest.raises(ValueError, match="Outer has no setting 'wrong'"):
        Variant(name="v", method="m", settings={"wrong": 1}).config(Outer(), {})


def test_every_named_variant_changes_a_method_that_exists_into_a_valid_configuration():
    for name in methods.names():
        variant = methods.chosen(name)
        assert variant.name == name
        default = methods.METHODS[variant.method].config()
        config = variant.config(default, {})
        assert (config != default) == (name in methods.VARIANTS)
        found = flattened(config)
        assert all(found[key] == value for key, value in variant.settings.items())


def test_the_ablations_switch_off_what_their_names_say():
    def config(name: str) -> Any:
        return methods.chosen(name).config(methods.METHODS[methods.chosen(name).method].config(), {})

    assert config("nova-no-sh").sh_weight is None
    assert config("nova-no-geo").consistency is None
    both = config("nova-no-n2v-sh")
    assert (both.denoiser, both.sh_weight) == (None, None)
    assert config("naive-l1").fit.dssim_weight == 0


def test_a_variant_of_a_variant_adds_its_settings():
    own = methods.with_variants(
        [Variant(name="a", method="nova-no-sh", settings={"init_scale": 0.5}),
         Variant(name="b", method="a", settings={"init_scale": 0.6, "refresh_after": 2})]
    )  # fmt: skip
    b = methods.chosen("b", own)
    assert (b.name, b.method) == ("b", "nova")
    assert b.settings == {"sh_weight": None, "init_scale": 0.6, "refresh_after": 2}


@pytest.mark.parametrize(
    ("variants", "match"),
    [
        ([Variant(name="nova", method="naive")], "needs a name of its own"),
        ([Variant(name="a", method="naive"), Variant(name="a", method="nova")], "needs a name of its own"),
        ([Variant(name="nova-fast", method="nova-fast")], "needs a name of its own"),
        ([Variant(name="a", method="nove")], "unknown method 'nove'; did you mean 'nova"),
        ([Variant(name="a", method="qqqqqq")], "unknown method 'qqqqqq'; available: nova"),
    ],
)
def test_variants_of_nothing_or_of_a_taken_name_are_refused(variants, match):
    with pytest.raises(ValueError, match=match):
        methods.with_variants(variants)


@dataclass(frozen=True, kw_only=True)
class Files:
    one: Path | None = None
    several: tuple[Path, ...] = (Path("default"),)
    label: str = "x"


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


def test_a_list_in_text_has_all_its_parts():
    assert changed(Outer(), {"inner.widths": "3,4,5"}).inner.widths == (3, 4, 5)
    assert changed(Outer(), {"inner.widths": [3, 4, 5]}).inner.widths == (3, 4, 5)
