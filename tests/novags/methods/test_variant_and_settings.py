"""Claims about settings by dotted name and about variants."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import pytest

from novags.methods import METHODS, VARIANTS, chosen, with_variants
from novags.methods.knob import MethodKnob
from novags.methods.nova.config import ConsistencyConfig, NovaConfig
from novags.methods.nova.denoiser_config import FAST_DENOISER, DenoiserConfig
from novags.methods.variant import Variant, parse_variant, read_variants
from novags.settings import changed, flattened, has_setting


@dataclass(frozen=True)
class Inner:
    share: float = 0.5
    widths: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class Outer:
    count: int = 3
    kind: Literal["none", "instance"] = "instance"
    limit: int | None = None
    fast: bool = False
    inner: Inner | None = field(default_factory=Inner)

    def __post_init__(self) -> None:
        if self.count < 0:
            raise ValueError(f"count must be >= 0, got {self.count}")


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("count", "7", 7),
        ("kind", "none", "none"),  # a choice of that name, not "off"
        ("limit", "4", 4),
        ("limit", "none", None),
        ("fast", "true", True),
        ("inner", "none", None),
        ("inner", "default", Inner()),
        ("inner.share", "0.25", 0.25),
        ("inner.widths", "16,32,64", (16, 32, 64)),
        ("inner.share", 0.75, 0.75),
    ],
)
def test_text_becomes_a_value_of_the_declared_type(name: str, text: object, value: object) -> None:
    found = changed(Outer(limit=9), {name: text})
    for part in name.split("."):
        found = getattr(found, part)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cuont": "1"}, "no setting 'cuont'; did you mean 'count'"),
        ({"inner.size": "1"}, "Inner has no setting 'size'; available: share, widths"),
        ({"count": "1.5"}, "count must be a whole number, got '1.5'"),
        ({"count": "none"}, "count must be a whole number, got 'none'"),
        ({"kind": "batch"}, "kind must be one of none, instance, got 'batch'"),
        ({"fast": "1"}, "fast must be true or false, got '1'"),
        ({"count": "-1"}, "count must be >= 0, got -1"),
        ({"count.x": "1"}, "count is a single value and has no setting 'x'"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        changed(Outer(), settings)


def test_naming_a_setting_of_a_part_that_is_off_switches_it_on() -> None:
    assert changed(Outer(inner=None), {"inner.share": 0.1}) == Outer(inner=Inner(share=0.1))
    assert not has_setting(Outer(inner=None), "inner.share")
    assert has_setting(Outer(), "inner.share")


def test_several_settings_are_checked_together() -> None:
    """Neither change alone is allowed: without a denoiser the penalty has no noise map to follow."""
    config = changed(NovaConfig(), {"denoiser": "none", "sh_weight": "none"})
    assert (config.denoiser, config.sh_weight) == (None, None)
    with pytest.raises(ValueError, match="sh_weight = 1.0 has no effect without a denoiser"):
        changed(NovaConfig(), {"denoiser": None})


def test_flattening_names_every_value_and_switched_off_parts() -> None:
    assert flattened(Outer(inner=None)) == {
        "count": 3, "kind": "instance", "limit": None, "fast": False, "inner": None,
    }  # fmt: skip
    assert flattened(Outer())["inner.widths"] == (1, 2)


def test_a_variant_as_text_keeps_lists_whole() -> None:
    variant = parse_variant("small=nova:denoiser.network.widths=16,32,denoiser.network.bottleneck=64,sh_weight=none")
    assert (variant.name, variant.method) == ("small", "nova")
    assert variant.settings == {
        "denoiser.network.widths": "16,32", "denoiser.network.bottleneck": "64", "sh_weight": "none",
    }  # fmt: skip
    config = variant.config(NovaConfig(), {})
    assert config.denoiser.network.widths == (16, 32)


@pytest.mark.parametrize("text", ["nova", "a=nova:", "a=:x=1", "a=nova:x", "a=nova:x=", "a/b=nova:x=1", "=nova:x=1"])
def test_what_is_not_a_variant_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="variant"):
        parse_variant(text)


def test_a_variants_own_settings_win_over_shared_ones_and_foreign_ones_are_passed_over() -> None:
    variant = Variant(name="short", method="naive", settings={"fit.iterations": 5})
    shared = {"fit.iterations": 100, "fit.sh_degree": 1, "denoiser.warmup_steps": 7}
    config = variant.config(METHODS["naive"].config(), shared)
    assert (config.fit.iterations, config.fit.sh_degree) == (5, 1)


def test_a_variant_of_a_variant_adds_to_it() -> None:
    own = with_variants([parse_variant("calm=nova-fast:sh_weight=0.5"), parse_variant("calmer=calm:consistency=none")])
    found = chosen("calmer", own)
    assert found.method == "nova"
    config = found.config(NovaConfig(), {})
    expected = replace(NovaConfig(), denoiser=replace(FAST_DENOISER, warmup_steps=500), consistency=None, sh_weight=0.5)
    assert config == expected


def test_names_that_are_taken_or_unknown_are_refused() -> None:
    with pytest.raises(ValueError, match="'naive' needs a name of its own"):
        with_variants([parse_variant("naive=nova:sh_weight=none")])
    with pytest.raises(ValueError, match="unknown method 'navie'; did you mean 'naive'"):
        with_variants([parse_variant("a=navie:fit.iterations=3")])
    with pytest.raises(ValueError, match="unknown method 'novva'"):
        chosen("novva")


def test_the_papers_ablations_can_be_said() -> None:
    paper = NovaConfig()
    made = {name: chosen(name).config(paper, {}) for name in VARIANTS if VARIANTS[name].method == "nova"}
    assert made["nova-no-sh"] == replace(paper, sh_weight=None)
    assert made["nova-no-geo"] == replace(paper, consistency=None)
    assert made["nova-no-n2v-sh"] == replace(paper, denoiser=None, sh_weight=None)
    assert made["nova-fast"] == replace(paper, denoiser=FAST_DENOISER, consistency=ConsistencyConfig(every=16))
    assert paper.denoiser == DenoiserConfig()
    tuned, spots = made["nova-tuned"], paper.denoiser.blind_spots
    assert tuned.denoiser == replace(paper.denoiser, noisy_share=0.7, blind_spots=replace(spots, laplacian_share=0.0))
    assert (tuned.fit.dssim_weight, tuned.fit.sh_degree, tuned.consistency) == (0.0, 2, paper.consistency)


@pytest.mark.parametrize("name", [*METHODS, *VARIANTS])
def test_every_name_gives_a_configuration_of_its_method(name: str) -> None:
    variant = chosen(name)
    method = METHODS[variant.method]
    config = variant.config(method.config(), {})
    assert type(config) is type(method.config())
    changes = {key for key, value in flattened(config).items() if flattened(method.config()).get(key, ...) != value}
    assert bool(changes) == (name not in METHODS)


def test_variants_can_be_written_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        '[variant.a]\nmethod = "nova"\nsh_weight = "none"\nfit.iterations = 5\ndenoiser.network.widths = [8, 16]\n'
        '[variant.b]\nmethod = "a"\n"fit.sh_degree" = 1\n'
    )
    own = with_variants(read_variants(file))
    config = chosen("b", own).config(NovaConfig(), {})
    assert (config.sh_weight, config.fit.iterations, config.fit.sh_degree) == (None, 5, 1)
    assert config.denoiser.network.widths == (8, 16)


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "has no table"), ("[variant.a]\nx = 1\n", 'needs method = "NAME"'), ("[[", "not a readable TOML file")],
)
def test_a_file_without_variants_says_what_it_lacks(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_variants(tmp_path / "mine.toml")


def test_a_knob_of_one_setting_has_every_value_and_finds_the_one_that_a_configuration_has() -> None:
    knob = MethodKnob.of("inner.share", (0.25, 0.5, 0.75), "so", ("fit",))
    assert knob.settings == {share: {"inner.share": share} for share in (0.25, 0.5, 0.75)}
    assert [knob.default(flattened(Outer(inner=Inner(share=share)))) for share in (0.75, 0.25)] == [0.75, 0.25]
    two = {"fast": {"count": 3, "fast": True}, "slow": {"count": 3, "fast": False}}
    assert MethodKnob(why="so", settings=two).default(flattened(Outer())) == "slow"
    with pytest.raises(ValueError, match=r"no setting of the knob agrees .*\(count = 4, fast = False\)"):
        MethodKnob(why="so", settings=two).default(flattened(Outer(count=4)))
