"""How fast the Gaussians of a run are drawn on this machine: a measurement, which no result depends on."""

import dataclasses
import time
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any

import torch

from novags.methods.saved import saved_gaussians
from novags.splats.views import Views
from sensor_model.files.records import Numbers, read_record

WIDTHS = (160, 800)  # px, of pictures as high as the training views are for their width
FRAMES, SECONDS = 7, 0.3  # of each width after a first frame that is not timed, whichever ends first
CAMERAS: Any = [{"width": int, "height": int, "fx": float, "fy": float, "position": Numbers(3),
                 "rotation": Numbers(3, 3)}]  # fmt: skip


def frames_per_second(scene: Path, cameras: Path, facts: Mapping[str, Any]) -> dict[str, Any] | None:
    """How many pictures of a run, with depth, are drawn in a second, one after another, by their width.

    Args:
        scene: The .ply file of a run.
        cameras: Its cameras.json; the view in the middle of the list is drawn.
        facts: Its record: how the Gaussians are shown, and the device that fitted them.

    Returns:
        The rates by `WIDTHS` as text, medians over frames; `device`, and the `threads` of the processor that drew. None
        where there are no Gaussians or no cameras.

    Raises:
        ValueError: If a file is damaged.
    """
    if not (scene.is_file() and cameras.is_file()):
        return None
    listed = read_record(cameras, CAMERAS, "reconstruct again")
    if not listed:
        return None
    device = "cuda" if str(facts.get("device")).startswith("cuda") and torch.cuda.is_available() else "cpu"
    shown = saved_gaussians(scene, facts)
    shown = dataclasses.replace(shown, gaussians=shown.gaussians.to(device))

    def draw(view: Views) -> float:
        start = time.perf_counter()
        shown.render(view)
        if device == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter() - start

    found: dict[str, Any] = {}
    for width in WIDTHS:
        view = _view(listed[len(listed) // 2], width).to(device)
        draw(view)
        spent = [draw(view)]
        while len(spent) < FRAMES and sum(spent) < SECONDS:
            spent.append(draw(view))
        found[str(width)] = 1 / median(spent)
    return {**found, "device": device, "threads": torch.get_num_threads()}


def _view(camera: Mapping[str, Any], width: int) -> Views:
    """A camera as cameras.json has it, with a picture of another size."""
    scale = width / camera["width"]
    height = max(1, round(scale * camera["height"]))
    turn, place = (torch.tensor(camera[name], dtype=torch.float64) for name in ("rotation", "position"))
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3], viewmat[:3, 3] = turn.T, -turn.T @ place
    K = torch.tensor([[scale * camera["fx"], 0, width / 2], [0, scale * camera["fy"], height / 2], [0, 0, 1]])
    return Views(viewmat.float()[None], K.float()[None], width, height)
