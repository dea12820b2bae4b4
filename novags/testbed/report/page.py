"""The report: one self-contained HTML file, made of blocks, on runs of one capture, of several, or on a study."""

import os
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from markupsafe import Markup

from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import RECORD
from novags.testbed.folders.runs import EXPERIMENT, REPORT
from novags.testbed.ledger.contents import digest, jsonable
from novags.testbed.ledger.dry import planned
from novags.testbed.report.blocks import (
    absent,
    configuration,
    cost,
    explain,
    header,
    length,
    light,
    look,
    ranking,
    scores,
    signal,
    simulated,
    training,
)
from novags.testbed.report.look.album import Album, files_of
from novags.testbed.report.material import Material, material_of
from novags.testbed.report.parts import Block, Page, plain
from novags.testbed.report.place import command_of, places_in
from novags.testbed.report.study import is_study, study_material
from novags.testbed.report.words import number, size
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_bytes, resolved
from sensor_model.files.lock import locked

BLOCKS = (  # of every page, in this order: a block taken out here is on no page
    Block("header", header.header),
    Block("look", look.look),
    Block("scores", scores.scores),
    Block("multiples", ranking.multiples),
    Block("length", length.length),
    Block("explain", explain.explain),
    Block("light", light.light, light.light_files),
    Block("failed", configuration.failed),
    Block("absent", absent.absent),
    Block("cameras", training.cameras),
    Block("flat", training.flat),
    Block("training", training.training),
    Block("cost", cost.cost),
    Block("signal", signal.signal),
    Block("simulated", simulated.simulated),
    Block("departures", configuration.departures),
    Block("configuration", configuration.configuration),
)


def write_report(folder: Path, console: Console) -> Path:
    """Write `folder`/report.html on a study of one place or a run, and return its path.

    Raises:
        ValueError: If the folder holds nothing scored, or folders it refers to are gone.
        BlockingIOError: If another process is writing there.
    """
    with locked(folder, make=False):
        return build(material_of(places_in([folder], console), folder / REPORT, command_of(folder)), console)


def ranking_of(folder: Path) -> list[str]:
    """The ranking that the report of a run, an experiment or a study begins with, in lines of text; [] without scores.

    Raises:
        ValueError: If nothing is finished there, or it cannot be read.
    """
    path = folder / REPORT
    study = is_study(folder)
    found = study_material(folder, path) if study else material_of(places_in([folder], Console(quiet=True)), path)
    shown = ranking.ranking(found)
    return [*plain(shown["table"]), *filter(None, [shown["legend"]])] if shown else []


def write_reports(
    folders: Sequence[Path], console: Console, *, out: Path | None = None, overwrite: bool = False
) -> Path:
    """Write one report on the runs of several folders and return its path.

    Args:
        folders: Runs, experiments, or folders that hold such.
        console: Where progress goes.
        out: The file. None: `folder`/report.html of a single folder, else comparison.html where all of them lie.
        overwrite: Replace `out` even if it is there and no report on the same runs.

    Raises:
        ValueError: If a folder holds nothing scored, folders it refers to are gone, or `out` is something else.
        BlockingIOError: If another process is writing there.
    """
    if len(folders) == 1 and out is None and any((folders[0] / name).exists() for name in (EXPERIMENT, RECORD)):
        return write_report(folders[0], console)
    path = out or report_path(folders)
    places = places_in(folders, console)
    identity = digest(sorted(str(resolved(run.path)) for place in places for run in place.runs.values()))
    if path.exists() and not overwrite and identity_of(path) != identity:
        raise ValueError(
            f"{path} already exists and is not a report on these runs: choose another --out, or add --overwrite"
        )
    with locked(path.parent):
        return build(material_of(places, path), console, identity)


def write_study(folder: Path, out: Path | None = None, *, overwrite: bool = False) -> Path:
    """Write the report on a study and return its path.

    Args:
        folder: Of the study.
        out: The HTML file; None: report.html in the folder. The other files go beside it.
        overwrite: Replace `out`, and files beside it, even if they are no report on this study.

    Raises:
        ValueError: If its tables cannot be read, nothing is done yet, or `out` is something else.
    """
    path, identity = out or folder / REPORT, digest(["study", str(resolved(folder))])
    material = study_material(folder, path)
    if resolved(path) != resolved(folder / REPORT) and not overwrite and not (
        path.exists() and identity_of(path) == identity
    ):  # fmt: skip
        beside = [] if resolved(path.parent) == resolved(folder) else light.files_in(path.parent, material.axes)
        if found := [file for file in (path, *beside) if file.exists()]:
            raise ValueError(f"{found[0]} already exists and is not of a report on this study: choose another --out, "
                             "or add --overwrite")  # fmt: skip
    return build(material, Console(), identity)


def report_path(folders: Sequence[Path]) -> Path:
    """Where the report on several folders goes by default: beside them, under a name that no stage uses."""
    if len(folders) == 1:
        return folders[0] / REPORT
    return Path(os.path.commonpath([resolved(folder).parent for folder in folders])) / "comparison.html"


def identity_of(path: Path) -> str | None:
    """Which runs, or which study, an earlier report is about; None if it does not say."""
    found = re.search(r'<meta name="novags-runs" content="([^"]*)">', read_bytes(path).decode("utf-8", "replace"))
    return found and found[1]


def build(material: Material, console: Console, identity: str = "") -> Path:
    """Write the page of every block that has something to show, and what goes beside it; returns its path."""
    path, beside = material.path, files_of(material.path)  # whether a page needs that folder is seen when it is made
    others = [file for block in BLOCKS for file in block.files(material)]
    planned(console, "report", [path, *([beside] if beside.exists() else []), *others])
    with console.progress("report") as progress:
        page = Page(path, Album(path), progress)
        made = sorted(BLOCKS, key=lambda block: block.name == "header")  # last, since it shows what others have found
        found = {block.name: block.read(material, page) for block in made}
    page.album.settle()
    shown = [(block.name, mine) for block in BLOCKS if (mine := found[block.name]) is not None]
    known = {
        "title": material.title,
        "colors": {look.key: look.color for look in material.looks.values()},
        "identity": identity,
        "files": beside.name,
    }
    write_text(path, filled("page.html", {**known, "blocks": shown, "data": page.data, "strip": page.strip}))
    return path


def filled(template: str, context: Mapping[str, Any]) -> str:
    """A page from its template."""
    return str(_templates().get_template(template).render(context))


@cache
def _templates() -> Any:
    """All templates; each is compiled once for the many pages of a site."""
    import jinja2

    loader = jinja2.PackageLoader("novags.testbed.report", "templates")
    templates = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                   lstrip_blocks=True)  # fmt: skip
    templates.filters.update(number=number, size=size, json=_embedded, contents=_contents)
    templates.globals.update(asset=_asset)
    return templates


def _asset(name: str) -> Any:
    """A script or a style, unchanged."""
    return Markup((files("novags.testbed.report") / name).read_text(encoding="utf-8"))


def _contents(body: str) -> list[tuple[str, Any]]:
    """The headings of a page, and where they are."""
    return [(name, Markup(heading)) for name, heading in re.findall(r'<h2 id="([^"]+)"[^>]*>(.*?)</h2>', body)]


def _embedded(value: Any) -> Any:
    """JSON that neither ends a script nor an attribute."""
    import jinja2.utils

    return jinja2.utils.htmlsafe_json_dumps(jsonable(value), separators=(",", ":"), allow_nan=False)
