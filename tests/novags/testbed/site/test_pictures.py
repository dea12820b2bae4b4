"""Claims about the pictures of a site: of every place of every study its own ones, each with its caption."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from novags.testbed.folders.run import Run
from novags.testbed.report.look.album import Album
from novags.testbed.report.place import Place
from novags.testbed.site.entries import SiteStudy
from novags.testbed.site.pictures import DARK, TRUTH, SitePicture, of_entry, shots_of
from simscenes.sets.pictures.png import write_png
from tests.novags.testbed.site.small_studies import dusk, night, studies

SIZE = (8, 12, 3)
HELD_OUT = "0003"


def grey(code: int) -> np.ndarray:
    return np.full(SIZE, code / 255, np.float32)


def code_of(shot: SitePicture | None) -> int | None:
    """The grey that a picture shows, to the nearest ten; None where there is no picture."""
    if shot is None or shot.picture.data is None:
        return None
    shown = cv2.imdecode(np.frombuffer(shot.picture.data, np.uint8), cv2.IMREAD_COLOR)
    return None if shown is None else 10 * round(float(shown.mean()) / 10)


def opener(folder: Path, renders: dict[str, int], dark: int | None, lit: int | None) -> Callable[[], Place]:
    """What opens a place whose second view is held out, grey everywhere; None where there is no such picture."""

    def opened() -> Place:
        runs = {}
        for method, code in renders.items():
            codes = np.full(SIZE, code, np.uint8)
            write_png(folder / method / "renders" / f"{HELD_OUT}.png", codes)
            record = {"name": method, "method": method, "space": "enhanced", "enhancement": None}
            runs[method] = Run(folder / method, record)
        capture: Any = SimpleNamespace(
            names=["0000", HELD_OUT], demosaiced=False, holds=lambda kind: True,
            is_dark=lambda i: i == 0 or dark is not None, srgb8=lambda i: grey((255, dark or 0)[i]),
        )  # fmt: skip
        source: Any = SimpleNamespace(
            lit_known=lit is not None, shows=lambda i: True, lit=lambda i: grey((0, lit or 0)[i])
        )
        known = {method: {"lit": {"aligned_psnr": 1.0, "tone_aligned_psnr": code / 10}}
                 for method, code in renders.items()}  # fmt: skip
        scores = {method: {"mean": own, "views": {HELD_OUT: own}} for method, own in known.items()}
        return Place(capture, source, runs, {"methods": scores}, [1])

    return opened


def pictured(folder: Path) -> list[SiteStudy]:
    """Two studies; of the first one the places have pictures of every grey, of the second one not all have some."""
    first, second = studies(folder, dusk=dusk(), night=night())
    for k, where in enumerate(dict.fromkeys(entry.line.where for entry in first.entries)):
        codes = {"naive": 60 + 10 * k, "better": 100 + 10 * k}
        first.material.places[where] = opener(folder / f"dusk-{k}", codes, 10 + 10 * k, 200 + 10 * k)
    barn, cave = dict.fromkeys(entry.line.where for entry in second.entries)
    second.material.places[barn] = lambda: None
    second.material.places[cave] = opener(folder / "night", {"oracle": 140, "naive": 150}, None, None)
    return [first, second]


def test_every_place_of_every_study_has_its_own_pictures(tmp_path: Path) -> None:
    found = pictured(tmp_path)
    shots = shots_of(found, Album(tmp_path / "index.html"), lambda *told: None)
    said = {(entry.study.name, entry.scene, entry.light, entry.method):
            [code_of(of_entry(shots, entry, key)) for key in (DARK, TRUTH, "render")]
            for study in found for entry in study.entries}  # fmt: skip
    assert said == {
        ("dusk", "attic", "5 electrons", "naive"): [10, 200, 60],
        ("dusk", "attic", "5 electrons", "better"): [10, 200, 100],
        ("dusk", "attic", "50 electrons", "naive"): [20, 210, 70],
        ("dusk", "attic", "50 electrons", "better"): [20, 210, 110],
        ("dusk", "barn", "5 electrons", "naive"): [30, 220, 80],
        ("dusk", "barn", "5 electrons", "better"): [30, 220, 120],
        ("dusk", "barn", "50 electrons", "naive"): [40, 230, 90],
        ("dusk", "barn", "50 electrons", "better"): [40, 230, 130],
        ("night", "barn", "2.5 electrons", "oracle"): [None, None, None],
        ("night", "barn", "2.5 electrons", "better"): [None, None, None],
        ("night", "barn", "2.5 electrons", "naive"): [None, None, None],
        ("night", "cave", "2.5 electrons", "oracle"): [None, None, 140],
        ("night", "cave", "2.5 electrons", "better"): [None, None, None],
        ("night", "cave", "2.5 electrons", "naive"): [None, None, 150],
    }


def test_a_place_of_which_no_view_is_shown_has_no_pictures(tmp_path: Path) -> None:
    (study,) = studies(tmp_path, dusk=dusk()[:2])
    place = opener(tmp_path, {"naive": 60}, 10, 200)()
    study.material.places[study.entries[0].line.where] = lambda: replace(place, views=[])
    assert shots_of([study], Album(tmp_path / "index.html"), lambda *told: None) == {}


def test_a_picture_says_what_it_shows(tmp_path: Path) -> None:
    found = pictured(tmp_path)
    shots = shots_of(found, Album(tmp_path / "index.html"), lambda *told: None)
    entry = next(entry for entry in found[0].entries if entry.method == "better")
    said = [(shot.label, shot.note) for key in (DARK, TRUTH, "render") if (shot := of_entry(shots, entry, key))]
    assert said == [
        ("Dark input", "what the camera delivers"), ("Truth: well lit", "the scene in good light"),
        ("better", "tone-aligned PSNR 10.0 dB"),
    ]  # fmt: skip


def test_progress_counts_the_places_of_all_studies(tmp_path: Path) -> None:
    told: list[tuple[float, float, str]] = []
    found = pictured(tmp_path)
    shots_of(found, Album(tmp_path / "index.html"), lambda done, of, text: told.append((done, of, text)))
    assert [done for done, _, _ in told] == [*range(7)]
    assert {of for _, of, _ in told} == {6}
    assert [text.partition(":")[0] for _, _, text in told] == ["dusk"] * 4 + ["night"] * 2 + [""]
