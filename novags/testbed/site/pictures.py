"""The pictures of a site: of each place one held-out view, dark, as each method shows it, and its truth."""

from collections.abc import Iterator
from dataclasses import dataclass

from novags.testbed.console.terminal import Update
from novags.testbed.folders.references import pictured, references
from novags.testbed.report.look.album import Album, Picture
from novags.testbed.report.look.pictures import TRUTHS, render_note, shown
from novags.testbed.report.place import Place
from novags.testbed.site.entries import Entry, SiteStudy

DARK, TRUTH = "dark", "truth"  # keys beside the methods' names, which stand behind "render-"


@dataclass(frozen=True)
class SitePicture:
    """A picture with its caption."""

    picture: Picture
    label: str
    note: str


Shots = dict[tuple[str, str, str], SitePicture]  # by study, place in words, and DARK, TRUTH or "render-METHOD"


def shots_of(studies: list[SiteStudy], album: Album, progress: Update) -> Shots:
    """The pictures of all places; they go into `album`."""
    found: Shots = {}
    places = [(study, where) for study in studies for where in study.material.places]
    for done, (study, where) in enumerate(places):
        progress(done, len(places), f"{study.name}: {where}")
        if (place := study.material.places[where]()) is not None and place.views:
            found |= {(study.name, where, key): shot for key, shot in _shots(place, album)}
    progress(len(places), len(places), "")
    return found


def of_entry(shots: Shots, entry: Entry, key: str) -> SitePicture | None:
    """A picture of an entry: the method's own for "render"."""
    own = f"render-{entry.line.method}" if key == "render" else key
    return shots.get((entry.study.name, entry.line.where, own))


def _shots(place: Place, album: Album) -> Iterator[tuple[str, SitePicture]]:
    capture, i = place.capture, place.views[0]
    name = capture.names[i]
    if capture.is_dark(i):
        yield DARK, SitePicture(album.add(capture.srgb8(i), exact=False), "Dark input", "what the camera delivers")
    truths = references(place.runs[place.main], capture, place.lit, i)
    if kind := next((kind for kind in ("lit", *truths) if kind in truths), None):
        label, note = TRUTHS[kind]
        yield TRUTH, SitePicture(album.add(shown(truths[kind], kind), exact=False), label, note)
    for method, run in place.runs.items():
        if run.shows(name):
            note = render_note(place, method, name)
            picture = album.add(pictured(run, capture, run.rendering(name)), exact=False)
            yield f"render-{method}", SitePicture(picture, method, note)
