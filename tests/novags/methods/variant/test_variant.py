"""Methods and variants by name."""

from dataclasses import dataclass, field
from typing import Any

import pytest

from novags import methods
from novags.methods.variant import Variant, parse_variant
from novags.settings import flattened


@dataclass(frozen=True, kw_only=True)
class Inner:
    size: int = 3


@dataclass(frozen=True, kw_only=True)
class Outer:
    rate: float = 0.5
    label: str = "x"
    inner: Inner = field(default_factory=Inner)
    part: Inner | None = None


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
    both = Variant(name="v", method="m", settings={"label": "own", "part": None})
    assert both.config(Outer(part=Inner()), {"label": "s", "part.size": 8}) == Outer(label="own", part=None)
    off_first = Variant(name="v", method="m", settings={"part": None, "label": "own"})
    assert off_first.config(Outer(part=Inner()), {"rate": 0.1, "part.size": 8}) == Outer(
        rate=0.1, label="own", part=None
    )
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
