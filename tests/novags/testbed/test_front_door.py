"""Claims about what a user finds without reading code: lists, help pages, the device, the version."""

import re

import pytest
import torch

from novags.cameras import SOURCES
from novags.commands.answers.catalogue import LISTS, first_sentence, listing
from novags.commands.answers.topics import page, topics
from novags.methods import METHODS, VARIANTS
from novags.methods.enhancers import ENHANCERS
from novags.testbed.console import devices
from novags.testbed.console.devices import chosen_device
from novags.testbed.console.terminal import Console
from novags.testbed.metrics import METRICS
from novags.testbed.study.cells.levels import LEVELS
from novags.testbed.study.cells.presets import EXPERIMENTS
from sensor_model import PRESETS as SENSORS
from sensor_model.effect_list import EFFECT_LIST
from simscenes import SCENES

QUIET = Console(quiet=True)
NAMES = {
    "scenes": SCENES, "sensors": SENSORS, "methods": {**METHODS, **VARIANTS}, "levels": LEVELS,
    "presets": EXPERIMENTS, "cameras": SOURCES, "enhancers": ENHANCERS, "metrics": METRICS,
    "effects": EFFECT_LIST,
}  # fmt: skip


@pytest.mark.parametrize("what", LISTS)
def test_a_list_names_everything_with_a_few_words(what: str) -> None:
    lines = listing(what).splitlines()
    named = {line.split()[0]: line for line in lines[1:] if re.match(r"  \S", line)}
    assert NAMES[what].keys() <= named.keys()
    for name in NAMES[what]:
        assert len(named[name].split()) > 3, name
    assert max(map(len, lines)) <= 160


def test_all_lists_are_one_page() -> None:
    assert listing() == "\n\n".join(listing(what) for what in LISTS)
    with pytest.raises(
        ValueError,
        match=r"no list of 'lenses'; .*available: scenes, sensors, methods, levels, presets, cameras, enh",
    ):
        listing("lenses")


def test_every_help_page_says_something_and_lines_fit_a_terminal() -> None:
    assert {"electrons", "cameras", "variants", "scores", "methods"} <= set(topics())
    for topic in topics():
        assert len(page(topic).split()) > 50
        assert max(map(len, page(topic).splitlines())) <= 120
    with pytest.raises(ValueError, match="no page about 'electron'; did you mean 'electrons'"):
        page("electron")


def test_the_help_pages_spell_commands_that_exist() -> None:
    from novags.cameras import parse_cameras
    from novags.methods import chosen, with_variants
    from novags.methods.variant import parse_variant

    for text in re.findall(r"--cameras (\S+)", page("cameras")):
        parse_cameras(text)
    texts = [text for text in re.findall(r'--variant "?([^\s",]+[^\s"]*)', page("variants")) if "=" in text]
    assert len(texts) >= 4
    own = with_variants([parse_variant(text) for text in texts])
    for name in own:
        variant = chosen(name, own)
        variant.config(METHODS[variant.method].config(), {})


def test_first_sentences_are_first_sentences() -> None:
    assert first_sentence("A table\n    of things. And more.") == "A table of things"
    assert first_sentence(None) == ""


def test_a_device_that_is_not_there_is_refused_and_auto_takes_what_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert chosen_device("auto", QUIET) == torch.device("cpu")
    with pytest.raises(ValueError, match="torch finds no GPU"):
        chosen_device("cuda", QUIET)
    with pytest.raises(ValueError, match="device must be one of auto, cpu, cuda, got 'tpu'"):
        chosen_device("tpu", QUIET)


def test_auto_takes_a_gpu_only_with_its_rasteriser_and_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda index: "Some GPU")
    monkeypatch.setattr(devices, "has_gsplat", lambda: True)
    assert chosen_device("auto", Console()) == torch.device("cuda")
    assert "device: Some GPU (cuda)" in capsys.readouterr().err
    monkeypatch.setattr(devices, "has_gsplat", lambda: False)
    assert chosen_device("auto", Console()) == torch.device("cpu")
    assert "needs gsplat: pip install 'novags[cuda]'" in capsys.readouterr().err


def test_the_list_of_sensors_says_which_quantum_efficiencies_are_assumed() -> None:
    text = " ".join(listing("sensors").split())
    assert "imx900-hcg 12 bit, read noise 1.95 e-, quantum efficiency 88 % (FRAMOS, at 536 nm), RGGB mosaic" in text
    assert "imx686-iso6400 10 bit, read noise 1.43 e-, quantum efficiency 60 % (assumed), RGGB mosaic" in text
