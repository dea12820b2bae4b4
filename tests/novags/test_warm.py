"""Kernels are compiled once for a user, with a word about it before a first fit."""

from pathlib import Path
from threading import Event

import pytest

from novags import warm
from novags.fields.training.config import FieldFitConfig
from novags.methods import METHODS, chosen


@pytest.fixture
def part(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """A part of kernels whose code is kept in the test's folder; the list grows when they are compiled."""
    calls: list[str] = []
    made = warm.KernelPart("do nothing", lambda: calls.append("compiled"), "novags.warm:PLACE", 7)
    monkeypatch.setattr(warm, "PLACE", tmp_path, raising=False)
    monkeypatch.setitem(warm.PARTS, "nothing", made)
    return calls


def test_kernels_are_compiled_once_and_the_user_is_told_how_long_it_takes(part: list[str]) -> None:
    said: list[str] = []
    warm.compile_ahead("nothing", said.append)
    warm.compile_ahead("nothing", said.append)
    assert part == ["compiled"]
    assert "do nothing, about 7 s, once on this machine" in said[0]
    assert len(said) == 2


def test_a_long_compilation_shows_signs_of_life(part: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    alive, said = Event(), list[str]()

    def say(text: str) -> None:
        said.append(text)
        if text.startswith("still compiling: "):
            alive.set()

    monkeypatch.setattr(warm, "BEAT", 0.01)
    long = warm.KernelPart("take long", lambda: part.append(str(alive.wait(60))), "novags.warm:PLACE", 7)
    monkeypatch.setitem(warm.PARTS, "nothing", long)
    warm.compile_ahead("nothing", say)
    assert part == ["True"]
    assert said[-1].startswith("compiled the kernels")


def test_kernels_that_failed_are_compiled_again(part: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise OSError("the disk is full")

    sound = warm.PARTS["nothing"]
    monkeypatch.setitem(warm.PARTS, "nothing", warm.KernelPart("do nothing", fail, sound.folder, 7))
    with pytest.raises(OSError, match="full"):
        warm.compile_ahead("nothing", print)
    monkeypatch.setitem(warm.PARTS, "nothing", sound)
    warm.compile_ahead("nothing", print)
    assert part == ["compiled"]


def test_without_a_folder_of_ones_own_the_user_is_sent_to_the_doctor(
    part: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warm, "PLACE", None, raising=False)
    said: list[str] = []
    for _ in range(2):
        warm.compile_ahead("nothing", said.append)
    assert part == ["compiled"] * 2
    assert "in every process, see novags doctor" in said[0]


@pytest.mark.parametrize("name", METHODS)
def test_every_method_that_fits_has_its_kernels_named(name: str) -> None:
    config = METHODS[chosen(name).method].config()
    fit = getattr(config, "fit", None)
    expected = None if fit is None else "fields" if isinstance(fit, FieldFitConfig) else "gaussians"
    assert warm.kernels_of(config) == expected
