"""A number that is not finite on a GPU: it is named later, and nothing that came after it has changed anything."""

import dataclasses
from typing import Any

import pytest
import torch
from torch import nn

from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import FAST_DENOISER
from novags.splats import Gaussians
from novags.splats.raster import raster_gsplat
from novags.splats.training import fit as loop
from novags.splats.training.companion import Companion
from novags.splats.training.config import CameraRefinement, FitConfig, McmcConfig
from novags.splats.training.flags import EVERY, Flags
from novags.splats.training.guard import NotFinite
from novags.splats.training.losses import photometric_loss
from novags.testbed.console.devices import has_gsplat
from tests.novags.gpu.stand_in import rasterization
from tests.novags.gpu.virtual import plain, virtual_gpu

WORKS = torch.cuda.is_available() and has_gsplat()
ITERATIONS, AT = 36, 13
CONFIG = FitConfig(
    iterations=ITERATIONS, sh_degree=1, sh_every=5, mcmc=McmcConfig(refine_start=1, refine_every=10, growth=1.1),
    cap_max=200, refine_cameras=CameraRefinement(start=3), checkpoint_every=1000,
)  # fmt: skip


@pytest.fixture
def gpu(monkeypatch):
    monkeypatch.setattr(raster_gsplat, "rasterization", rasterization)
    with virtual_gpu() as waits:
        yield waits


@pytest.fixture(params=[
    "virtual",
    pytest.param("real", marks=[
        pytest.mark.gpu,
        pytest.mark.skipif(not WORKS, reason="needs a CUDA device and gsplat; the virtual one does the same"),
    ]),
])  # fmt: skip
def any_gpu(request):
    """A GPU that is there, or the virtual one."""
    if request.param == "virtual":
        request.getfixturevalue("gpu")


class Gain(nn.Module):
    """A companion: one factor of the render."""

    def __init__(self) -> None:
        super().__init__()
        self.factor = nn.Parameter(torch.ones(()))


class Fit:
    """A fit on the virtual GPU whose photometric loss is damaged from an iteration on."""

    def __init__(self, problem, monkeypatch, damage, path, first=AT) -> None:
        start = Gaussians.from_points(problem.start.points, problem.start.colors, sh_degree=0)
        self.saved: list[Any] = []
        self.before: dict[int, Any] = {}
        self.told: list[float] = []
        monkeypatch.setattr(loop, "save_checkpoint", lambda path, state, settings: self.saved.append(snapshot(state)))
        original = loop.backpropagate

        def watched(state: Any, views: Any, iteration: int, *rest: Any, **options: Any) -> Any:
            self.before[iteration] = snapshot(state)
            return original(state, views, iteration, *rest, **options)

        monkeypatch.setattr(loop, "backpropagate", watched)
        gain = Gain().to("cuda")
        images = problem.srgb8.to("cuda")

        def photometric(step: Any, target: torch.Tensor) -> torch.Tensor:
            loss = photometric_loss(gain.factor * step.render, target, 0.2)
            return damage(loss, step) if step.iteration >= first else loss

        self.run = lambda: loop.fit(
            start.to("cuda"), problem.views.to("cuda"), lambda i: images[i], CONFIG, photometric=photometric,
            companion=Companion(network=gain, optimizer=torch.optim.Adam(gain.parameters(), lr=1e-2)),
            checkpoint=path, progress=lambda done, *_: self.told.append(done),
        )  # fmt: skip


def snapshot(state: Any) -> dict[str, Any]:
    tensors = {f"gaussians {name}": t for name, t in state.gaussians.tensors().items()}
    for name in ("first", "second"):
        tensors |= {f"{name} {key}": t for key, t in getattr(state.adam, name).items()}
    tensors |= {f"cameras {name}": t for name, t in vars(state.cameras).items()}
    tensors |= {name: t for name, t in state.companion.state().items() if ".grad." not in name}
    copies = {name: plain(t.detach()).clone() for name, t in tensors.items()}
    return {"iteration": state.iteration, "adam": state.adam.count, **copies}


def differences(found: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    assert found.keys() == wanted.keys()
    return [
        name for name, value in found.items()
        if not (torch.equal(value, wanted[name]) if isinstance(value, torch.Tensor) else value == wanted[name])
    ]  # fmt: skip


def infinite(loss: torch.Tensor, step: Any) -> torch.Tensor:
    return loss / 0


def without_slope(loss: torch.Tensor, step: Any) -> torch.Tensor:
    """Finite, with a gradient that is not."""
    return loss + (step.render - step.render.detach()).abs().sqrt().sum()


@pytest.mark.parametrize(("damage", "name"), [(infinite, "the loss photometric"), (without_slope, "gradient of means")])
def test_a_fault_is_named_with_its_iteration_and_the_state_before_it_is_saved(
    problem, monkeypatch, any_gpu, tmp_path, damage, name
) -> None:
    fit = Fit(problem(), monkeypatch, damage, tmp_path / "state")
    view = CONFIG.view_at(AT, 5)
    with pytest.raises(NotFinite, match=f"^{name} must be finite, and is not at iteration {AT}, view {view}; ") as stop:
        fit.run()
    assert stop.value.resumable
    assert max(fit.before) == EVERY - 1  # it was found at the next reading
    assert fit.told == [10]
    (saved,) = fit.saved
    assert saved["iteration"] == saved["adam"] == AT
    assert differences(saved, fit.before[AT]) == []
    assert len(differences(fit.before[AT], fit.before[AT - 1])) > 15  # nearly everything had moved until then
    later = differences(fit.before[EVERY - 1], fit.before[AT])
    assert later == ["iteration", "adam"]


def test_a_parameter_that_an_update_has_damaged_is_not_saved(problem, monkeypatch, any_gpu, tmp_path) -> None:
    fit = Fit(problem(), monkeypatch, lambda loss, step: loss, tmp_path / "state")
    original = loop._move

    def damaging(state: Any, iteration: int, *rest: Any) -> None:
        original(state, iteration, *rest)
        if iteration == AT:
            state.gaussians.log_scales[3] = torch.nan

    monkeypatch.setattr(loop, "_move", damaging)
    with pytest.raises(NotFinite, match=f"^parameter log_scales must be .* at iteration {AT + 1}, view ") as stop:
        fit.run()
    assert not stop.value.resumable
    assert fit.saved == []


def test_a_fault_in_the_last_iteration_is_noticed(problem, monkeypatch, any_gpu, tmp_path) -> None:
    fit = Fit(problem(), monkeypatch, infinite, tmp_path / "state", first=ITERATIONS - 1)
    with pytest.raises(NotFinite, match=f"at iteration {ITERATIONS - 1}, "):
        fit.run()
    assert [saved["iteration"] for saved in fit.saved] == [ITERATIONS - 1]


def test_a_denoiser_keeps_its_weights_from_before_a_fault(problem, gpu) -> None:
    config = dataclasses.replace(FAST_DENOISER, crop=None)
    denoiser = Denoiser(problem().srgb8.to("cuda"), config, total_steps=100, seed=0)
    for _ in range(3):
        denoiser.train_step()
    assert denoiser.flags is not None
    denoiser.flags.read()
    before = {name: plain(t).clone() for name, t in denoiser.state().items() if "generator" not in name}
    denoiser.images = denoiser.images * torch.nan
    waited = sum(gpu.values())
    for _ in range(5):
        denoiser.train_step()
    assert sum(gpu.values()) == waited
    with pytest.raises(NotFinite, match=r"the denoiser's loss must be finite, and is not at denoiser step 3, view \d"):
        denoiser.flags.read()
    after = {name: plain(t) for name, t in denoiser.state().items() if name in before}
    assert [name for name in differences(after, before) if name not in ("denoiser.steps", "denoiser.places")] == []


def test_numbers_kept_before_a_fault_arrive_and_later_ones_do_not(gpu) -> None:
    flags, arrived = Flags(torch.device("cuda")), []
    one = torch.ones((), device="cuda")
    for i in range(4):
        flags.iteration = i
        flags.look({"left": one, "right": one / (2 - i) if i >= 2 else one}, f"in step {i}")
        flags.keep(one[None] * i, arrived.extend)
    assert sum(gpu.values()) == 0
    with pytest.raises(NotFinite, match="^right must be finite, and is not in step 2$"):
        flags.read()
    assert sum(gpu.values()) == 1
    assert arrived == [0, 1]
    assert flags.iteration == 2
    assert float(flags.bad) == 1


def test_reading_again_after_good_numbers_tells_nothing_twice(gpu) -> None:
    flags, arrived = Flags(torch.device("cuda")), []
    flags.keep(torch.arange(3.0, device="cuda"), arrived.append)
    flags.read()
    flags.read()
    assert arrived == [[0, 1, 2]]
    assert Flags.on(torch.device("cpu")) is None
