"""A field as the scene of a reconstruction, and its file."""

import dataclasses
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from novags.fields.box import Box
from novags.fields.field import Field
from novags.fields.layout import SIDE, FieldLayout
from novags.fields.march import Proposal
from novags.fields.render import render_field
from novags.methods.nerf.shading import shading_of
from novags.splats.files.tensors import write_tensors
from novags.splats.views import Views
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief
from sensor_model.files.records import check_shape, parse_json

FILE = Path("scene") / "field.safetensors"  # in the folder of a run
RECORD = {
    "layout": {"coarsest": int, "finest": int, "log2_rows": int, "static": int, "viewed": int},
    "box": {"center": [float], "half": [float], "near": float, "middle": float, "far": float},
    "samples": int, "shading": str, "numbers": {"*": float},
}  # fmt: skip


@dataclass(frozen=True)
class FieldScene:
    """A radiance field, and how its outputs become colours; it lives on the CPU.

    Attributes:
        field: The field.
        box: Where it is.
        proposal: The map that rays are sampled after.
        samples: Per ray.
        shading: One of `SHADINGS`.
        numbers: Of the shading.
    """

    field: Field
    box: Box
    proposal: Proposal
    samples: int
    shading: str = "display"
    numbers: dict[str, float] = dataclasses.field(default_factory=dict)

    def render(self, views: Views) -> tuple[Tensor, Tensor, Tensor]:
        """As `ReconstructedScene` says, on the device of the views."""
        shading = shading_of(self.shading, self.numbers)
        with torch.no_grad():
            return render_field(self.field, self.box, self.proposal, views, shading, self.samples)

    def save(self, folder: Path) -> None:
        """Write scene/field.safetensors, which `load_field` reads."""
        (folder / FILE).parent.mkdir(exist_ok=True)
        record = {"layout": asdict(self.field.layout), "box": self.box.record(), "samples": self.samples,
                  "shading": self.shading, "numbers": dict(self.numbers)}  # fmt: skip
        tensors = {name: t.detach() for name, t in self.field.tensors().items()}
        tensors |= {"seeded": self.field.seeded, "proposal": torch.from_numpy(self.proposal.density)}
        write_tensors(folder / FILE, tensors, metadata={"field": json.dumps(record)})

    def facts(self) -> dict[str, Any]:
        """Sizes of the field."""
        tensors = self.field.tensors().values()
        return {"field": {"parameters": sum(t.numel() for t in tensors), "samples": self.samples,
                          "bytes": sum(t.numel() * t.element_size() for t in tensors)}}  # fmt: skip


def load_field(folder: Path) -> FieldScene | None:
    """Load the field that a run has saved in its folder; None if the run has no field.

    Raises:
        ValueError: If its file is damaged.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        with safe_open(admitted(path), framework="pt") as file:
            record = parse_json((file.metadata() or {})["field"], "its record")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # not a dict
        check_shape(record, RECORD, "its record")
        found = _assembled(record, tensors)
        shading_of(found.shading, found.numbers)
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        reason = brief(f"{type(error).__name__}: {error}")
        raise ValueError(f"{path} is not a field of this version ({reason}): reconstruct again") from error
    return found


def _assembled(record: dict[str, Any], tensors: dict[str, Tensor]) -> FieldScene:
    density = tensors.pop("proposal")
    if density.dtype != torch.float32 or density.shape != (SIDE**3,):
        raise ValueError(f"the map must be float32 [{SIDE**3}], got {density.dtype} {list(density.shape)}")
    for name, tensor in {**tensors, "proposal": density}.items():
        if tensor.dtype not in (torch.float32, torch.uint8) or not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"{name} must be finite float32, got {tensor.dtype}")
    if record["samples"] < 1:
        raise ValueError(f"samples must be >= 1, got {record['samples']}")
    box: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record["box"].items()}
    if len(box["center"]) != 3 or len(box["half"]) != 3 or not np.isfinite([*box["center"], *box["half"]]).all():
        raise ValueError(f"the box must have three finite coordinates, got {box}")
    return FieldScene(
        Field(FieldLayout(**record["layout"]), **tensors), Box(**box), Proposal(density.numpy()), record["samples"],
        record["shading"], record["numbers"],
    )  # fmt: skip
