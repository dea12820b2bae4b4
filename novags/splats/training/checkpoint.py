"""Training state on disk, as safetensors: a run that is stopped and resumed gives the same bits as one that was not."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from sensor_model.files.door import admitted
from sensor_model.files.reading import brief
from sensor_model.files.records import check_shape, parse_json

from ..files.tensors import write_tensors
from ..gaussians import Gaussians
from .companion import PREFIX, Companion
from .updates.adam import Adam
from .updates.camera_refinement import CameraState

STATE = {"iteration": int, "adam": int, "losses": [{"*": float}], "seconds": float, "settings": dict}


@dataclass(kw_only=True)
class TrainingState:
    """Everything the next iteration depends on (random numbers come from seed and iteration), and the log so far.

    Attributes:
        gaussians: Current Gaussians.
        adam: Their optimiser.
        cameras: Refinement of the training cameras; None where they stay as given.
        companion: Parameters trained beside them; None: nothing.
        iteration: Iterations done.
        losses: Log entries.
        seconds: Wall time spent before this process took over.
        kept: Copies of the Gaussians on the CPU, by the iterations done, as `FitConfig.keep_at` asks.
    """

    gaussians: Gaussians
    adam: Adam
    cameras: CameraState | None = None
    companion: Companion | None = None
    iteration: int = 0
    losses: list[dict[str, float]] = field(default_factory=list)
    seconds: float = 0.0
    kept: dict[int, Gaussians] = field(default_factory=dict)

    def keep(self) -> None:
        """Keep a copy of the Gaussians as they are after this iteration."""
        copies = {name: t.detach().clone().cpu() for name, t in self.gaussians.tensors().items()}
        self.kept[self.iteration] = Gaussians(**copies)


def save_checkpoint(path: Path, state: TrainingState, settings: dict[str, object]) -> None:
    """Write the state, atomically.

    Args:
        path: File to write.
        state: The state to write.
        settings: The run's at its start, JSON-able; compared on resume.
    """
    tensors = {f"gaussians.{name}": t.detach() for name, t in state.gaussians.tensors().items()}
    tensors |= {f"first.{name}": t for name, t in state.adam.first.items()}
    tensors |= {f"second.{name}": t for name, t in state.adam.second.items()}
    if state.cameras is not None:
        tensors |= {f"cameras.{name}": t.detach() for name, t in vars(state.cameras).items()}
    if state.companion is not None:
        tensors |= state.companion.state()
    for at, gaussians in state.kept.items():
        tensors |= {f"kept.{at}.{name}": t for name, t in gaussians.tensors().items()}
    rest = {
        "iteration": state.iteration, "adam": state.adam.count, "losses": state.losses, "seconds": state.seconds,
        "settings": settings,
    }  # fmt: skip
    write_tensors(path, tensors, metadata={"state": json.dumps(rest)})


def load_checkpoint(
    path: Path, settings: dict[str, object], device: torch.device, companion: Companion | None = None
) -> TrainingState:
    """Read a file of `save_checkpoint`.

    Args:
        path: File to read.
        settings: The run's now.
        device: Of the tensors read.
        companion: Receives the state of the companion that was trained in that run.

    Raises:
        ValueError: If the file is not a training checkpoint, or belongs to a run with other settings.
    """
    try:
        with safe_open(admitted(path), framework="pt", device=str(device)) as file:
            rest = parse_json((file.metadata() or {})["state"], "its state")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # not a dict
        check_shape(rest, STATE, "its state")
        saved = rest["settings"]
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:  # ValueError: malformed JSON
        reason = brief(f"{type(error).__name__}: {error}")
        raise ValueError(
            f"{path} is not a training checkpoint of this version ({reason}): delete it to start again"
        ) from error
    now = json.loads(json.dumps(settings))
    different = sorted(key for key in saved.keys() | now.keys() if saved.get(key) != now.get(key))
    if different:
        changes = brief(", ".join(f"{k}: {saved.get(k)!r} there, {now.get(k)!r} now" for k in different), 1000)
        raise ValueError(
            f"checkpoint {path} belongs to a run with other settings ({changes}); delete it or restore them"
        )
    try:
        state = _assembled(rest, tensors, saved)
        if (companion is not None) != any(name.startswith(f"{PREFIX}.") for name in tensors):
            raise ValueError("something was trained beside its Gaussians, and nothing is now, or the other way round")
        if companion is not None:
            companion.restore(tensors)
            state.companion = companion
        return state
    except (TypeError, ValueError) as error:  # TypeError: tensors missing or too many
        raise ValueError(f"{path} is damaged ({brief(error)}): delete it to start again") from error


def _assembled(rest: dict[str, Any], tensors: dict[str, Tensor], settings: dict[str, Any]) -> TrainingState:
    """The state, if its parts belong together and to a run with these settings."""

    def part(prefix: str) -> dict[str, Tensor]:
        return {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}

    done = rest["iteration"]
    if not 0 <= done <= settings["iterations"] or rest["adam"] != done:
        raise ValueError(f"iteration {done} of {settings['iterations']}, and {rest['adam']} steps of the optimiser")
    gaussians = Gaussians(**part("gaussians."))
    if not len(gaussians) or gaussians.sh_degree != settings["sh_degree"]:
        raise ValueError(f"{len(gaussians)} Gaussians of degree {gaussians.sh_degree}")
    adam = Adam(gaussians)
    adam.count, adam.first, adam.second = done, part("first."), part("second.")
    for prefix, moments in (("first.", adam.first), ("second.", adam.second)):
        _check_like(gaussians.tensors(), moments, prefix)
    _check_like(gaussians.tensors(), gaussians.tensors(), "gaussians.")
    cameras = part("cameras.")
    if bool(cameras) != (settings.get("refine_cameras") is not None):
        raise ValueError("camera refinement is there, and the settings have none, or the other way round")
    if cameras:
        _check_like(vars(CameraState.of(gaussians.means.new_zeros(settings["views"], 4, 4))), cameras, "cameras.")
    return TrainingState(
        gaussians=gaussians, adam=adam, cameras=CameraState(**cameras) if cameras else None,
        iteration=done, losses=rest["losses"], seconds=rest["seconds"],
        kept={at: Gaussians(**part(f"kept.{at}.")) for at in settings.get("keep_at", ()) if at <= done},
    )  # fmt: skip


def _check_like(wanted: dict[str, Tensor], found: dict[str, Tensor], prefix: str) -> None:
    if wanted.keys() != found.keys():
        odd = sorted(wanted.keys() ^ found.keys())
        raise ValueError(f"the tensors {prefix}* must be {', '.join(wanted)}; {', '.join(odd)} missing or too many")
    for name, like in wanted.items():
        tensor, kind = found[name], torch.int64 if name == "visits" else torch.float32
        if tensor.shape != like.shape or tensor.dtype != kind:
            raise ValueError(
                f"{prefix}{name} must be {kind} {list(like.shape)}, got {tensor.dtype} {list(tensor.shape)}"
            )
        if not torch.isfinite(tensor).all():
            raise ValueError(f"{prefix}{name} must be finite")
