"""How it looks: pictures, maps and the probe, of a few views of every place."""

from collections.abc import Sequence
from typing import Any

from novags.testbed.report.look.maps import ERROR_CEILING
from novags.testbed.report.look.pictures import ViewTiles, view_tiles
from novags.testbed.report.material import Material, Place
from novags.testbed.report.parts import Page, Strip
from novags.testbed.report.verdict import compared, leading


def look(material: Material, page: Page) -> dict[str, Any] | None:
    """The views of every place; views that cannot be shown are named with the reason."""
    views, unseen = list[ViewTiles](), dict(material.unseen)
    first: tuple[list[str], list[str]] = ([], [])
    for done, (name, opened) in enumerate(material.places.items()):
        try:
            if (place := opened()) is None:
                continue
            mine = _views(place, name, page, done, len(material.places))
        except (ValueError, OSError) as error:  # one damaged or old run must not cost the page of many
            if material.one:
                raise
            unseen[name] = str(error)
            continue
        page.strip = page.strip or (strip_of(place, mine[0]) if mine else None)
        views += mine
        for side, key in zip(first, compared(place), strict=True):
            side.append(key)
        for run in place.runs:
            if any(tile.key == f"render-{run}" for tile in mine[0].tiles):
                page.views[name, run] = mine[0].name
    left, right = (list(dict.fromkeys(keys)) for keys in first)
    page.data.update(left=[*left, "enhanced"], right=[*right, "truth-lit"])
    kinds = {tile.key.partition("-")[0] for view in views for tile in view.tiles}
    found = {
        "views": views,
        "names": short_names(views),
        "unseen": unseen,
        "kinds": kinds,
        "error_ceiling": ERROR_CEILING,
    }
    return found if views or unseen else None


def short_names(views: Sequence[ViewTiles]) -> list[str]:
    """The views by the parts of their names that differ: whole names would not fit into a list of choices."""
    parts = [(*view.name.split(", "), "held out" if view.held_out else "training") for view in views]
    shared = set.intersection(*map(set, parts)) if len(parts) > 1 else set()
    return [" · ".join(part for part in each if part not in shared) or view.name
            for each, view in zip(parts, views, strict=True)]  # fmt: skip


def strip_of(place: Place, view: ViewTiles) -> Strip:
    """The film strip of a held-out view: those of its pictures that are there."""
    kind, known = (leading(place) or ("", "", ""))[0], {tile.key: tile for tile in view.tiles}
    truth = next((key for key in (f"truth-{kind}", "truth-lit") if key in known), "")
    keys = dict.fromkeys(("dark", *compared(place), truth))
    return Strip(view, [known[key] for key in keys if key in known])


def _views(place: Place, name: str, page: Page, done: int, places: int) -> list[ViewTiles]:
    found = []
    for i in place.views:
        found.append(view_tiles(i, place, page.album, name))
        count = len(place.views)
        page.progress(done * count + len(found), places * count, f"view {found[-1].name}" if places == 1 else name)
    return found
