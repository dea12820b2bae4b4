"""Rows of tables that results were made with and that are not here, as of a package that is gone."""

from collections.abc import Iterator
from typing import Any

from novags.cameras import SOURCES
from novags.cameras.spelling import source_named
from novags.methods import METHODS
from novags.testbed.metrics import METRICS
from novags.testbed.metrics.truth import BIAS, ERROR, VARIANCE
from novags.testbed.report.material import Material, RunRecords
from novags.testbed.report.parts import Page
from simscenes import SCENES

PICTURES = ("enhanced", "enhanced_demosaiced", "lit")  # the references that scores of pictures are against


def absent(material: Material, page: Page) -> dict[str, Any] | None:
    """The missing rows by kind and name, each with its effect on the page; None where none is missing."""
    found = dict(fact for each in material.made.values() for fact in _of_run(each))
    scores = (column.partition(".") for row in material.rows for column in row)
    # What stands beside a score has no row of its own, and a reference that is not known is a column without a name.
    names = dict.fromkeys(name if name in METRICS else name.removesuffix(ERROR).removesuffix(BIAS)
                          for kind, _, name in scores if kind in PICTURES and name not in ("", VARIANCE))  # fmt: skip
    found |= {f"metric {name}": "no column: whether more of it is better is not known"
              for name in names if METRICS.get(name) is None}  # fmt: skip
    return {"facts": found} if found else None


def _of_run(made: RunRecords) -> Iterator[tuple[str, str]]:
    run, stage = made.run, made.rendered.get("stage", {})
    # The programs of a study have no row anywhere.
    if METHODS.get(run.method) is None and "command" not in run.record["config"]:
        yield f"method {run.method}", "no published settings to compare with, and no command that makes its runs again"
    if run.lacks is not None:
        yield f"enhancer {run.record['enhancement']['enhancer']}", f"no picture that went through it ({run.lacks})"
    source = source_named(str((run.record.get("cameras") or {}).get("source", "known")))
    if SOURCES.get(source) is None:
        yield f"cameras {source}", "no command that makes its runs again"
    # Of the catalogue: a scene of a file is known by its content.
    name = str(stage.get("inputs", {}).get("scene"))
    if stage.get("config", {}).get("scene") == name and SCENES.get(name.partition(":")[0]) is None:
        yield f"scene {name}", "its set is shown, and cannot be rendered again"
