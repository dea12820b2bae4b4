"""Claims about training states with missing or odd parts: refused by name, never taken for a finished run."""

import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from novags.splats import FitConfig, Gaussians, McmcConfig, Views, fit
from novags.splats.training.config import CameraRefinement

N, SIZE = 5, 8
CONFIG = FitConfig(iterations=4, sh_degree=1, mcmc=McmcConfig(), refine_cameras=CameraRefinement(start=1))


def run(path: Path, config: FitConfig = CONFIG) -> int:
    """Fit, and continue from `path` if it is there; the number of losses that are logged."""
    points = torch.linspace(-1, 1, N)[:, None].expand(N, 3) * torch.tensor([1.0, 0.5, 0.1])
    start = Gaussians.from_points(points, torch.full((N, 3), 0.5), sh_degree=0)
    viewmat = torch.eye(4)
    viewmat[2, 3] = 3.0
    K = torch.tensor([[9.0, 0, SIZE / 2], [0, 9.0, SIZE / 2], [0, 0, 1]])
    views = Views(viewmat.repeat(2, 1, 1), K.repeat(2, 1, 1), SIZE, SIZE)
    return len(fit(start, views, lambda i: torch.full((SIZE, SIZE, 3), 0.3), config, checkpoint=path).losses)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("state") / "c.safetensors"
    run(path)
    return path


def rewritten(source: Path, target: Path, tensors: dict[str, Tensor | None], **state: object) -> Path:
    """A copy with some tensors replaced (None: left out) and some entries of its state."""
    with safe_open(source, framework="pt") as file:
        rest = json.loads(file.metadata()["state"]) | state
        own = {name: file.get_tensor(name) for name in file.keys()} | tensors  # not a dict
    kept = {name: tensor for name, tensor in own.items() if tensor is not None}
    save_file(kept, target, metadata={"state": json.dumps(rest)})
    return target


def test_a_whole_state_is_continued(written: Path, tmp_path: Path) -> None:
    assert run(rewritten(written, tmp_path / "c.safetensors", {})) == 1


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"iteration": 10**9}, "iteration 1000000000 of 4"),
        ({"iteration": 3}, "iteration 3 of 4, and 4 steps of the optimiser"),
        ({"iteration": -1, "adam": -1}, "iteration -1 of 4"),
        ({"iteration": 3.5}, "iteration must be a whole number"),
        ({"iteration": "4"}, "iteration must be a whole number"),
        ({"adam": None}, "adam must be a whole number"),
        ({"seconds": "long"}, "seconds must be a finite number"),
        ({"losses": [1]}, r"losses\[0\] must be an object"),
        ({"losses": {}}, "losses must be a list"),
        ({"settings": []}, "settings must be an object"),
    ],
)
def test_a_state_with_odd_numbers_is_refused(
    state: dict[str, object], message: str, written: Path, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=rf"c\.safetensors .*{message}.*delete it"):
        run(rewritten(written, tmp_path / "c.safetensors", {}, **state))


@pytest.mark.parametrize(
    ("tensors", "message"),
    [
        ({"gaussians.sh": None}, "sh"),
        ({"gaussians.sh": torch.zeros(N, 1, 3)}, "degree 0"),
        ({"gaussians.means": torch.full((N, 3), torch.nan)}, "gaussians.means must be finite"),
        (
            {"gaussians.means": torch.zeros(N, 3, dtype=torch.float64)},
            r"gaussians.means must be torch.float32 \[5, 3\]",
        ),
        ({"gaussians.extra": torch.zeros(1)}, "extra"),
        ({"first.quats": None}, r"first\.\*.*quats missing"),
        ({"first.quats": torch.zeros(N - 1, 4)}, r"first.quats must be torch.float32 \[5, 4\], got .* \[4, 4\]"),
        ({"second.means": torch.full((N, 3), torch.inf)}, "second.means must be finite"),
        ({"cameras.twists": torch.zeros(7, 6)}, r"cameras.twists must be torch.float32 \[2, 6\]"),
        ({"cameras.visits": torch.zeros(2)}, "cameras.visits must be torch.int64"),
        (dict.fromkeys(("cameras.twists", "cameras.first", "cameras.second", "cameras.visits")), "camera refinement"),
    ],
)
def test_a_state_with_missing_or_odd_tensors_is_refused(
    tensors: dict[str, Tensor | None], message: str, written: Path, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=rf"c\.safetensors is damaged \(.*{message}.*delete it"):
        run(rewritten(written, tmp_path / "c.safetensors", tensors))
