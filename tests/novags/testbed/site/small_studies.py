"""Studies that are tables alone, with runs that lie on no machine: enough for the rows and the names of a site."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.site.entries import SiteStudy, studies_of

QUIET = Console(quiet=True)
AXES = ("scene", "photos", "level", "electrons", "sensor", "width", "method", "seed")
PSNR, LIT, FLIP = "enhanced.aligned_psnr", "lit.tone_aligned_psnr", "enhanced.flip"

Row = Mapping[str, Any]
# Of both seeds. At the first place and at the last one the methods differ by less than seeds scatter.
DUSK = {("attic", 5, "naive"): (20.0, 20.4), ("attic", 5, "better"): (20.5, 20.1),
        ("attic", 50, "naive"): (26.0, 27.0), ("attic", 50, "better"): (23.0, 24.0),
        ("barn", 5, "naive"): (18.0, 19.0), ("barn", 5, "better"): (22.0, 23.0),
        ("barn", 50, "naive"): (31.0, 31.8), ("barn", 50, "better"): (31.5, 31.1)}  # fmt: skip
NIGHT = {("barn", 2.5, "oracle"): 33.0, ("barn", 2.5, "better"): 15.0, ("barn", 2.5, "naive"): 14.0,
         ("cave", 2.5, "oracle"): 34.0, ("cave", 2.5, "better"): 16.0, ("cave", 2.5, "naive"): 17.0}  # fmt: skip


def dusk() -> list[Row]:
    """Two scenes at two light levels, each by two methods and two seeds."""
    return [{"scene": scene, "electrons": electrons, "sensor": "full frame", "method": method, "seed": seed,
             PSNR: score}
            for (scene, electrons, method), scores in DUSK.items() for seed, score in enumerate(scores)]  # fmt: skip


def night() -> list[Row]:
    """Two scenes, one of them new, with another camera, by three methods of which one sees truth."""
    return [{"scene": scene, "electrons": electrons, "sensor": "telephone", "width": 64, "method": method, PSNR: score,
             FLIP: score / 100}
            for (scene, electrons, method), score in NIGHT.items()]  # fmt: skip


def write_study(folder: Path, rows: Sequence[Row]) -> Path:
    """The folder of a study with these rows, finished where they say nothing else; `better` is a variant of `naive`."""
    folder.mkdir(parents=True)
    axes = {name: [*dict.fromkeys(row[name] for row in rows)] for name in AXES if name in rows[0]}
    table = [{"run": number, "state": "done", **row} for number, row in enumerate(rows, 1)]
    (folder / "results.json").write_text(json.dumps({"axes": axes, "rows": table}))
    study = {"variant": {"better": {"method": "naive"}}}
    (folder / "study.json").write_text(json.dumps({"file": f"{folder.name}.toml", "table": study}))
    return folder


def studies(folder: Path, **rows: Sequence[Row]) -> list[SiteStudy]:
    """The studies of a site in `folder`, by their names."""
    return studies_of([write_study(folder / name, own) for name, own in rows.items()], folder / "site", QUIET)
