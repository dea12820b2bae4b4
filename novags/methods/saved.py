"""Gaussians of a run, read from its folder, to be splatted as the method did."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.tone import ResponseTable, ToneCurve
from novags.splats.files.ply import read_ply
from novags.splats.training.config import NEAR, FitConfig


def saved_gaussians(path: Path, facts: Mapping[str, Any]) -> GaussianScene:
    """The Gaussians in a .ply file, shown as these facts of their scene say (`GaussianScene.facts`).

    Raises:
        ValueError: If the file is damaged.
    """
    dilation = float(facts.get("eps2d", FitConfig.eps2d))
    antialiased = bool(facts.get("antialiased", FitConfig.antialiased))
    near = float(facts.get("near_plane", NEAR))
    tone, matrix, found = (facts.get(name) for name in ("tone", "matrix", "response"))
    curve, rows = None if tone is None else ToneCurve(**tone), None if matrix is None else torch.tensor(matrix)
    response = None if found is None else ResponseTable(**{**found, "values": tuple(found["values"])})
    return GaussianScene(read_ply(path), dilation, antialiased, near, curve, rows, response)
