"""The tables of a study, as its report reads them."""

from __future__ import annotations

import json
from pathlib import Path

from tests.fuzz.case import Reader

AXES = {"scene": ["a"], "electrons": [5, 50], "method": ["naive", "mine"], "seed": [0]}


def make_study(folder: Path) -> None:
    """Four runs, none of whose folders are there."""
    rows = []
    for electrons in AXES["electrons"]:
        for method in AXES["method"]:
            rows.append({
                "run": len(rows) + 1, "scene": "a", "electrons": electrons, "method": method, "seed": 0,
                "state": "failed" if len(rows) == 3 else "done", "reason": None, "stage": None, "folder": "../x",
                "enhanced.aligned_psnr": 20.5, "lit.tone_aligned_psnr": 21.5, "geometry.abs_rel": "inf",
                "recovered": 0.5, "cameras.registered_share": 1.0, "peak_bytes": 100,
            })  # fmt: skip
    (folder / "results.json").write_text(json.dumps({"axes": AXES, "columns": [], "rows": rows}))
    table = {"variant": {"mine": {"method": "naive", "fit.iterations": 5}}}
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": table}))


def read_study(folder: Path, file: Path) -> None:
    """As the report does."""
    from novags.testbed.report.page import write_study

    write_study(folder)


def _page() -> None:
    import cv2
    import torch

    import novags.testbed.report.page  # noqa: F401

    torch.set_num_threads(1)
    cv2.setNumThreads(0)


READERS = [
    Reader("tables of studies", make_study, read_study, ("results.json", "study.json"), share=1, prepare=_page),
]
