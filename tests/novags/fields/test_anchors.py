"""First points say what a field shows there: gradients of plain torch, and places that no ray has seen."""

import dataclasses
import importlib

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.fields.box import box_of, contracted
from novags.fields.evaluate import evaluate
from novags.fields.field import first_field
from novags.fields.layout import SIDE, FieldLayout
from novags.fields.reference import evaluate_reference
from novags.fields.training.anchors import COUNT, Anchors
from novags.fields.training.batch import Batch
from novags.fields.training.config import FieldFitConfig
from novags.fields.training.fit import fit_field
from novags.splats.views import Views

fitting = importlib.import_module("novags.fields.training.fit")  # the package has a function of that name
BOX = box_of(torch.tensor([[0.0, 0.0, -4.0]]), torch.from_numpy(np.random.default_rng(2).normal(size=(400, 3))))
QUICK = FieldFitConfig(
    iterations=150, rays=128, samples=16, warm=10, layout=FieldLayout(finest=64, log2_rows=12), distortion=0.0
)


def test_gradients_are_those_of_the_weighted_loss_at_the_points_in_plain_torch() -> None:
    layout = FieldLayout(coarsest=3, finest=40, log2_rows=10, static=1, viewed=3)
    field = first_field(layout, 3, np.arange(SIDE**3) % 3 == 0)
    field.table.copy_(torch.randn(field.table.shape, generator=torch.Generator().manual_seed(0)))
    points, aims = torch.randn(60, 3, dtype=torch.float64), torch.rand(60, 5, dtype=torch.float64)

    def loss(chosen: Tensor, raw: Tensor) -> Tensor:
        return (raw - aims[chosen]).square().sum(1).mean()

    found = Anchors.at(points, BOX, loss, 0.25).slopes(field, np.random.default_rng(8))
    chosen = torch.from_numpy(np.random.default_rng(8).integers(0, 60, COUNT))
    tensors = {name: t.double().requires_grad_() for name, t in field.tensors().items()}
    places = contracted(points, BOX).float()[chosen]
    ways = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).expand(COUNT, 4)
    raw = evaluate_reference(layout, tensors, field.seeded, places, ways)
    (0.25 * loss(chosen, raw)).backward()
    for name, tensor in tensors.items():
        assert tensor.grad is not None
        scale = float(tensor.grad.abs().max())
        assert scale > 0
        np.testing.assert_allclose(found[name], tensor.grad.numpy(), atol=1e-4 * scale, rtol=1e-3, err_msg=name)


def test_what_points_ask_for_is_added_to_what_rays_ask_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """`anchored` is a weight of the loss at the points, and nothing weighs their gradients again."""
    points, real = torch.randn(50, 3, dtype=torch.float64), fitting.gradients
    views = Views(torch.eye(4)[None], torch.tensor([[[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]]]), 16, 16)
    asked, taken = [], []
    monkeypatch.setattr(fitting, "gradients", lambda *given: asked.append(real(*given)) or asked[-1])
    monkeypatch.setattr(
        Anchors, "slopes", lambda *_: {name: np.float32(3) for name in ("table", "w1", "b1", "w2", "b2")}
    )
    monkeypatch.setattr(fitting, "_update", lambda state, slopes, rate: taken.append(slopes))
    config = dataclasses.replace(QUICK, iterations=1)
    fit_field(views, points, BOX, lambda batch: batch.raw.square().mean(), config, at_points=lambda *_: torch.zeros(()))
    for name, slope in asked[0].items():
        np.testing.assert_allclose(taken[0][name], slope + 3, rtol=1e-6)


def test_what_no_ray_has_seen_has_the_colours_of_the_first_points_and_what_rays_see_is_theirs() -> None:
    """A wall that is green to the camera, whose points say that it is red, as they do of one behind the camera."""
    flat = np.random.default_rng(1).uniform(-1, 1, (1000, 2))
    depth = np.where(np.arange(1000) < 500, 0.0, -8.0)
    points = torch.from_numpy(np.column_stack([flat, depth]))
    viewmat, K = torch.eye(4), torch.tensor([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]])
    viewmat[2, 3] = 4.0
    views, green, red = (
        Views(viewmat[None], K[None], 16, 16),
        torch.tensor([0.1, 0.8, 0.1]),
        torch.tensor([0.8, 0.1, 0.1]),
    )
    box = box_of(views.centers, points)

    def seen(batch: Batch) -> Tensor:
        return (batch.rendered(torch.sigmoid(batch.raw[..., 1:])) - green).square().mean()

    def at_points(chosen: Tensor, raw: Tensor) -> Tensor:
        return (torch.sigmoid(raw[:, 1:]) - red).square().mean()

    behind = {}
    for anchored in (0.0, 0.1):
        config = dataclasses.replace(QUICK, anchored=anchored)
        state = fit_field(views, points, box, seen, config, at_points=at_points).state
        assert state.losses[-1]["loss"] < 0.01  # the picture is green: the mean square of red would be 0.33
        inner = points[(points[:, 2] < -1) & (points[:, :2].abs().amax(1) < 0.8)]
        raw, _ = evaluate(state.field, contracted(inner, box).float().numpy(), np.array([[1, 0, 0, 0]], np.float32))
        behind[anchored] = torch.sigmoid(torch.from_numpy(raw[:, 1:])).mean(0)
    assert (behind[0.0] - red).abs().max() > 0.25
    assert (behind[0.1] - red).abs().max() < 0.1
