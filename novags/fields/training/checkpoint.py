"""Training state of a field on disk: a run that is stopped and resumed gives the same bits as one that was not."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as default
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from novags.fields.field import Field, first_field
from novags.fields.layout import FieldLayout
from novags.fields.march import Proposal
from novags.splats.files.tensors import write_tensors
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief
from sensor_model.files.records import check_shape, parse_json

STATE = {"iteration": int, "steps": int, "looked": int, "losses": [{"*": float}], "seconds": float, "settings": dict}


@dataclass(kw_only=True)
class FieldState:
    """Everything the next step depends on (random numbers come from seed and iteration), and the log so far.

    Attributes:
        field: The field.
        proposal: The map that rays are sampled after.
        extra: Further trained tensors, by name.
        first: First moments of Adam, by name of the tensor.
        second: Second moments.
        steps: Of Adam.
        looked: The cell of the map that is looked at next.
        iteration: Steps done.
        losses: Log entries.
        seconds: Wall time spent before this process took over.
    """

    field: Field
    proposal: Proposal
    extra: dict[str, Tensor]
    first: dict[str, Tensor]
    second: dict[str, Tensor]
    steps: int = 0
    looked: int = 0
    iteration: int = 0
    losses: list[dict[str, float]] = default(default_factory=list)
    seconds: float = 0.0

    @staticmethod
    def of(field: Field, proposal: Proposal, extra: dict[str, Tensor]) -> "FieldState":
        """A state before the first step."""
        tensors = {**field.tensors(), **extra}
        zeros = [{name: torch.zeros_like(t) for name, t in tensors.items()} for _ in range(2)]
        return FieldState(field=field, proposal=proposal, extra=extra, first=zeros[0], second=zeros[1])

    def tensors(self) -> dict[str, Tensor]:
        """All trained tensors by name."""
        return {**self.field.tensors(), **self.extra}


def _maps(state: FieldState) -> dict[str, Tensor]:
    return {"proposal": torch.from_numpy(state.proposal.density), "seeded": state.field.seeded}


def save_state(path: Path, state: FieldState, settings: dict[str, object]) -> None:
    """Write the state, atomically; `settings` are the run's at its start, JSON-able, compared on resume."""
    groups = {"value": state.tensors(), "first": state.first, "second": state.second}
    tensors = {f"{group}.{name}": t.detach() for group, part in groups.items() for name, t in part.items()}
    tensors |= _maps(state)
    rest = {name: getattr(state, name) for name in ("iteration", "steps", "looked", "losses", "seconds")}
    write_tensors(path, tensors, metadata={"state": json.dumps({**rest, "settings": settings})})


def load_state(path: Path, settings: dict[str, object], layout: FieldLayout, extra: Mapping[str, Tensor]) -> FieldState:
    """Read a file of `save_state`; `extra` tensors are changed in place.

    Raises:
        ValueError: If the file is not a training checkpoint of a field, or belongs to a run with other settings.
    """
    try:
        with safe_open(admitted(path), framework="pt") as file:
            rest = parse_json((file.metadata() or {})["state"], "its state")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # not a dict
        check_shape(rest, STATE, "its state")
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        reason = brief(f"{type(error).__name__}: {error}")
        raise ValueError(
            f"{path} is not a training checkpoint of a field of this version ({reason}): delete it to start again"
        ) from error
    saved, now = rest.pop("settings"), json.loads(json.dumps(settings))
    different = sorted(key for key in saved.keys() | now.keys() if saved.get(key) != now.get(key))
    if different:
        changes = brief(", ".join(f"{k}: {saved.get(k)!r} there, {now.get(k)!r} now" for k in different), 1000)
        raise ValueError(
            f"checkpoint {path} belongs to a run with other settings ({changes}); delete it or restore them"
        )
    state = FieldState.of(first_field(layout, 0), Proposal(), dict(extra))
    groups = {"value": state.tensors(), "first": state.first, "second": state.second}
    wanted = {f"{group}.{name}": t for group, part in groups.items() for name, t in part.items()}
    wanted |= _maps(state)
    fits = tensors.keys() == wanted.keys() and all(
        tensors[name].shape == t.shape and tensors[name].dtype == t.dtype and torch.isfinite(tensors[name]).all()
        for name, t in wanted.items()
    )
    if not fits:
        raise ValueError(f"{path} is damaged (its tensors do not fit the field): delete it to start again")
    for name, tensor in wanted.items():
        tensor.detach().copy_(tensors[name])
    for name, value in rest.items():
        setattr(state, name, value)
    return state
