"""`scripts/files/licences.py`: what novags needs can be given away with it."""

import email
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def licences(monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "files"))
    import licences

    yield licences
    del sys.modules["licences"]


def test_every_package_that_novags_needs_names_a_free_licence(licences) -> None:  # type: ignore[no-untyped-def]
    found = licences.needed("novags", set(), {})
    assert {"novags", "torch", "numba", "llvmlite", "mitsuba", "openexr"} <= set(found)
    assert "pytest" not in found
    found.pop("cuda-toolkit", None)  # a list of parts without a file; torch asks for it where it comes with CUDA
    assert {name: kind for name in found if not licences.free(kind := licences.licence(found[name]))} == {}


@pytest.mark.parametrize(
    ("name", "free"),
    [
        ("BSD-3-Clause", True), ("MIT OR GPL-3.0-only", True), ("LGPL-3.0-or-later", True), ("", False),
        ("GNU Lesser General Public License v3 (LGPLv3)", True), ("GPL-3.0-only", False), ("AGPL-3.0", False),
        ("GNU General Public License v3 (GPLv3)", False), ("GPL, by its text", False),
    ],
)  # fmt: skip
def test_a_licence_that_would_bind_novags_is_no_free_one(licences, name: str, free: bool) -> None:  # type: ignore[no-untyped-def]
    assert licences.free(name) == free


def test_an_expression_goes_before_a_word_and_a_word_before_classifiers(licences) -> None:  # type: ignore[no-untyped-def]
    lines = ["License-Expression: MIT", "License: BSD", "Classifier: License :: OSI Approved"]
    for expected in ("MIT", "BSD", "OSI Approved"):
        assert licences.licence(SimpleNamespace(metadata=email.message_from_string("\n".join(lines)))) == expected
        lines.pop(0)
