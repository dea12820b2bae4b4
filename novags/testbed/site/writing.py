"""Write a site: the report of every study, its tables, and pages of all methods and scenes that lead to each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.methods import METHODS
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import read_json, write_json
from novags.testbed.ledger.difference import flat
from novags.testbed.report.blocks.ranking import ranking
from novags.testbed.report.look.album import OWN, Album, files_of
from novags.testbed.report.page import BLOCKS, build, filled
from novags.testbed.report.rows import Row, deviations
from novags.testbed.report.words import named, size
from novags.testbed.site.entries import STUDIES_IN, Entry, SiteStudy, looks_of_all, pages_of, studies_of, told_apart
from novags.testbed.site.latex import latex
from novags.testbed.site.pictures import DARK, TRUTH, Shots, of_entry, shots_of
from novags.testbed.site.tables import entries_table
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_text, resolved

RECORD = "site.json"
WRITTEN: Any = {"pages": [str]}
INDEX, RANKING = "index.html", "ranking.tex"
METHODS_IN, SCENES_IN = "methods", "scenes"
PARTS = (INDEX, "index.files", STUDIES_IN, METHODS_IN, SCENES_IN, RECORD)  # of a site, in its folder
SCRIPTS = ("state", "rows", "tables", "filters", "cells")


@dataclass(frozen=True)
class Site:
    """A site in the making.

    Attributes:
        folder: Where it is written.
        studies: In the order given.
        entries: Of all studies.
        looks: How each method appears, by name.
        links: The pages of "Method", "Scene" and "Study" by name, relative to the folder.
        shots: The pictures.
    """

    folder: Path
    studies: Sequence[SiteStudy]
    entries: Sequence[Entry]
    looks: Mapping[str, Row]
    links: Mapping[str, Mapping[str, str]]
    shots: Shots

    def table(self, name: str, label: str, entries: Sequence[Entry], up: str) -> Any:
        """The rows of some entries."""
        return entries_table(name, label, entries, self.looks, self.links, up)

    def write(self, page: str, template: str, **context: Any) -> str:
        """Write a page; returns its place."""
        colors = {row.key: row.color for row in self.looks.values()}
        known = {"colors": colors, "identity": "", "data": {}, "scripts": SCRIPTS, "up": "../" * page.count("/")}
        write_text(self.folder / page, filled(f"site/{template}.html", known | context))
        return page


def write_site(folders: Sequence[Path], out: Path, console: Console, *, overwrite: bool = False) -> Path:
    """Write a site on studies and return its first page.

    Args:
        folders: Of studies, experiments, runs, or folders that hold such.
        out: Folder of the site. Pages of an earlier site there that have no place in this one are removed.
        console: Where progress goes.
        overwrite: Write into a folder that holds other things than a site.

    Raises:
        ValueError: If a folder has nothing finished or cannot be read, or `out` holds other things.
    """
    before = _pages_before(out, overwrite)
    for folder in folders:
        if resolved(out) == resolved(folder) or resolved(folder) in resolved(out).parents:
            raise ValueError(f"--out {out} lies in {folder}, which the site is about: choose a folder beside it")
    studies = studies_of(folders, out, console)
    album = Album(out / INDEX, inside=0)
    out.mkdir(parents=True, exist_ok=True)
    with console.progress("site: pictures") as progress:
        shots = shots_of(studies, album, progress)
    album.settle()
    entries = told_apart([entry for study in studies for entry in study.entries])
    links = {"Method": pages_of((entry.method for entry in entries), METHODS_IN),
             "Scene": pages_of((entry.scene for entry in entries), SCENES_IN),
             "Study": {study.name: study.page for study in studies}}  # fmt: skip
    site = Site(out, studies, entries, looks_of_all(entries), links, shots)
    made = [page for study in studies for page in _study(site, study, console)]
    made += [_method(site, name) for name in links["Method"]]
    made += [_scene(site, name) for name in links["Scene"]]
    made.append(_index(site))
    for page in set(before) - set(made):
        (out / page).unlink(missing_ok=True)
    write_json(out / RECORD, {"pages": sorted(made)})
    return out / INDEX


def _pages_before(out: Path, overwrite: bool) -> list[str]:
    """The pages of the site that is there.

    Raises:
        ValueError: If there are other things.
    """
    if (out / RECORD).is_file():
        found: list[str] = read_json(out / RECORD, WRITTEN)["pages"]
        return [page for page in found if ".." not in Path(page).parts and not Path(page).is_absolute()]
    others = [path for path in out.iterdir() if not path.name.startswith(".")] if out.is_dir() else []
    if others and not overwrite:
        raise ValueError(f"{out} holds {others[0].name} and no {RECORD}: choose another --out, or add --overwrite")
    return []


def _study(site: Site, study: SiteStudy, console: Console) -> list[str]:
    """The report of a study with its files, and its tables beside it."""
    page = build(study.material, console)
    place = Path(study.page).parent
    beside = [file for block in BLOCKS for file in block.files(study.material)]
    beside += [file for file in files_of(page).glob("*") if OWN.fullmatch(file.name)]
    made = [file.relative_to(site.folder).as_posix() for file in (page, *beside)]
    for file in study.files:
        write_text(site.folder / place / file.name, read_text(file))
        made.append((place / file.name).as_posix())
    if shown := ranking(study.material):
        write_text(site.folder / place / RANKING, latex(shown["table"]) + f"% {shown['legend']}\n")
        made.append((place / RANKING).as_posix())
    return made


def _index(site: Site) -> str:
    cards = []
    for study in site.studies:
        states = [row["state"] for row in study.material.rows]
        folder = Path(study.page).parent
        files = [(file.name, (folder / file.name).as_posix()) for file in study.files]
        if (site.folder / folder / RANKING).is_file():
            files.append((RANKING, (folder / RANKING).as_posix()))
        cards.append({"name": study.name, "title": study.material.title, "page": study.page, "files": files,
                      "done": states.count("done"), "runs": len(states), "shot": _first(site, study)})  # fmt: skip
    looks = site.looks
    return site.write(
        INDEX,
        "index",
        title=f"{len(cards)} {'study' if len(cards) == 1 else 'studies'} of reconstruction in the dark",
        studies=cards,
        table=site.table("entries", "Every method at every place", site.entries, ""),
        methods=[(named(looks[name]), page, looks[name].title) for name, page in site.links["Method"].items()],
        scenes=[*site.links["Scene"].items()],
    )


def _first(site: Site, study: SiteStudy) -> Any:
    """A picture that stands for a study."""
    return next((shot for entry in study.entries if (shot := of_entry(site.shots, entry, TRUTH))), None)


def _method(site: Site, name: str) -> str:
    entries = [entry for entry in site.entries if entry.method == name]
    look = site.looks[name]
    row = METHODS.get(look.method)
    made = [(entry, records) for entry in entries for records in entry.runs]
    settings, differs = dict[str, Any](), dict[str, list[Any]]()
    for entry, records in made:
        differs.setdefault(entry.study.name, deviations(records.run))
        settings = settings or flat(records.run.record["config"])
    facts = [("method", look.method), ("family", look.family), ("source", "" if row is None else row.source),
             ("sees the truth", "" if look.competes else "yes: a bound and no rival"),
             ("peak memory", size(max(each.run.peak_bytes for _, each in made)) if made else "")]  # fmt: skip
    pictures = [{"shot": shot, "truth": of_entry(site.shots, entry, TRUTH), "entry": entry,
                 "scene": site.links["Scene"][entry.scene]}
                for entry in entries if (shot := of_entry(site.shots, entry, "render"))]  # fmt: skip
    return site.write(
        site.links["Method"][name], "method", title=name, look=named(look), what=look.title,
        facts=[(key, value) for key, value in facts if value], pictures=pictures, settings=settings,
        differs={study: found for study, found in differs.items() if found},
        table=site.table("places", f"{name} everywhere", entries, "../"),
    )  # fmt: skip


def _scene(site: Site, name: str) -> str:
    entries = [entry for entry in site.entries if entry.scene == name]
    strips: dict[tuple[str, str], list[Any]] = {}
    for entry in entries:
        key = entry.study.name, entry.line.where
        if key not in strips:
            strips[key] = [shot for kind in (DARK, TRUTH) if (shot := of_entry(site.shots, entry, kind))]
        if shot := of_entry(site.shots, entry, "render"):
            strips[key].append(shot)
    return site.write(
        site.links["Scene"][name], "scene", title=name,
        strips=[(f"{study}: {where}" if where else study, found) for (study, where), found in strips.items() if found],
        table=site.table("methods", f"All methods on {name}", entries, "../"),
    )  # fmt: skip
