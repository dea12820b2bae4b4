"""What a site is made of: studies, and one entry for each method at each place of them."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import digest
from novags.testbed.report.grid import CAPTURE, SCENE, Line
from novags.testbed.report.material import Material, RunRecords, material_of
from novags.testbed.report.place import command_of, places_in
from novags.testbed.report.rows import Row, distinct
from novags.testbed.report.study import is_study, study_material
from novags.testbed.study.cells.grid import spelled
from novags.testbed.study.differences import DIFFERENCES
from novags.testbed.study.light import ELECTRONS
from novags.testbed.study.results import CSV
from sensor_model.files.door import resolved

PHOTOS = "photos"  # an axis that stands for the scene
NAMED = (SCENE, PHOTOS, ELECTRONS, "sensor", CAPTURE)  # axes that have columns of their own
STUDIES_IN = "studies"  # folder of a site
LEVEL = "level"  # an axis that stands for camera and electrons


@dataclass(frozen=True)
class SiteStudy:
    """A study of a site.

    Attributes:
        name: Of its page, different for every study of the site.
        folder: Its folder.
        material: What its report is made of.
    """

    name: str
    folder: Path
    material: Material

    @property
    def page(self) -> str:
        """Its report, relative to the site."""
        return f"{STUDIES_IN}/{self.name}/index.html"

    @property
    def files(self) -> list[Path]:
        """Its tables, which the site offers as they are."""
        return [file for name in (CSV, DIFFERENCES) if (file := self.folder / name).is_file()]

    @cached_property
    def entries(self) -> list["Entry"]:
        """One for each line of its grid that has a score."""
        return [Entry(self, line) for line in self.material.lines if line.spread]


@dataclass(frozen=True)
class Entry:
    """A method at a place of a study: all runs that differ in their seed alone."""

    study: SiteStudy
    line: Line
    apart: bool = False  # whether another study means another method by its name

    @property
    def look(self) -> Row:
        """How its method appears in the study."""
        return self.study.material.looks[self.line.method]

    @property
    def method(self) -> str:
        """The name of its method or variant: of runs of several captures the name that they share."""
        made = self._made
        name = made.run.name if made and not self.study.material.study else self.line.method
        return f"{name} ({self.study.name})" if self.apart else name

    @property
    def meant(self) -> tuple[str, str | None]:
        """The method behind its name, and the settings that make a variant of it, where they are known."""
        made = self._made
        return self.look.method, None if made is None else digest(made.run.record.get("variant", {}))

    @property
    def scene(self) -> str:
        """Its scene, with its variation."""
        found = self.line.place.get(SCENE) or self.line.place.get(PHOTOS)
        made = self._made
        return str(found or (made and (made.rendered.get("scene") or made.set.name)) or "unknown")

    @property
    def light(self) -> str:
        """The electrons of its capture, or the level of a data set."""
        made, place = self._made, self.line.place
        if LEVEL in place:
            return str(place[LEVEL])
        found = place.get(ELECTRONS, made and made.captured.get("electrons"))
        return f"{found:g} electrons" if isinstance(found, int | float) else "photographs"

    @property
    def camera(self) -> str:
        """The name of its camera; "" where it is not known."""
        made = self._made
        return str(self.line.place.get("sensor") or (made and made.captured.get("sensor_name")) or "")

    @property
    def rest(self) -> str:
        """All other axes of the study."""
        return spelled({name: value for name, value in self.line.place.items() if name not in (*NAMED, LEVEL)})

    @property
    def runs(self) -> list[RunRecords]:
        """Its runs that are on this machine."""
        return self.study.material.of(self.line)

    @property
    def _made(self) -> RunRecords | None:
        return next(iter(self.runs), None)


def studies_of(folders: Sequence[Path], site: Path, console: Console) -> list[SiteStudy]:
    """The studies of these folders.

    Args:
        folders: Of studies, experiments, runs, or folders that hold such.
        site: Folder of the site.
        console: Where warnings go.

    Raises:
        ValueError: If none is named, or one has nothing finished or cannot be read.
    """
    if not folders:
        raise ValueError("name at least one folder of a study, of an experiment or of runs")
    found: list[SiteStudy] = []
    for folder in folders:
        plain, taken = plain_name(resolved(folder).name), {study.name.lower() for study in found}
        name = next(each for k in range(1, len(found) + 2) if (each := plain + f"-{k}" * (k > 1)).lower() not in taken)
        path = site / STUDIES_IN / name / "index.html"
        if is_study(folder):
            material = study_material(folder, path)
        else:
            material = material_of(places_in([folder], console), path, command_of(folder))
        found.append(SiteStudy(name, folder, material))
    return found


def told_apart(entries: Sequence[Entry]) -> list[Entry]:
    """The same; a name by which studies mean several methods, or variants with other settings, has the study behind
    it.
    """
    meant: dict[str, tuple[set[str], set[str]]] = {}
    for entry in entries:
        (method, settings), (methods, several) = entry.meant, meant.setdefault(entry.method, (set(), set()))
        methods.add(method)
        several.update([] if settings is None else [settings])
    return [replace(entry, apart=max(map(len, meant[entry.method])) > 1) for entry in entries]


def looks_of_all(entries: Iterable[Entry]) -> dict[str, Row]:
    """How each method appears on the pages of all studies, by name."""
    found: dict[str, Row] = {}
    for entry in entries:
        if entry.method not in found:
            color = distinct(entry.look.color, [row.color for row in found.values()])
            found[entry.method] = replace(entry.look, name=entry.method, key=f"m{len(found)}", color=color)
    return found


def plain_name(text: str) -> str:
    """A name for a file and an address, of letters, digits and a few signs."""
    return re.sub(r"[^A-Za-z0-9._+-]+", "-", text).strip("-.")[:80] or "page"


def pages_of(names: Iterable[str], folder: str) -> dict[str, str]:
    """A page for each name, relative to the site; names that differ have pages that differ."""
    found: dict[str, str] = {}
    for name in dict.fromkeys(names):
        taken, plain = {page.lower() for page in found.values()}, plain_name(name)
        pages = (f"{folder}/{plain}{f'-{k}' if k > 1 else ''}.html" for k in range(1, len(found) + 2))
        found[name] = next(page for page in pages if page.lower() not in taken)
    return found
