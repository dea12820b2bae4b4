"""A field learns what it is shown, to the same bits however often it is stopped, and says where it cannot."""

import dataclasses
import importlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.fields import render as rendering
from novags.fields.box import Box, box_of
from novags.fields.field import first_field
from novags.fields.layout import SIDE, FieldLayout
from novags.fields.march import Proposal, cells_near
from novags.fields.render import render_field
from novags.fields.training.batch import Batch
from novags.fields.training.config import FieldFitConfig
from novags.fields.training.fit import FieldFit, fit_field
from novags.splats.training.guard import NotFinite
from novags.splats.views import Views

WIDTH, HEIGHT = 27, 22
fitting = importlib.import_module("novags.fields.training.fit")
TINY = FieldFitConfig(
    iterations=150,
    rays=256,
    samples=16,
    warm=10,
    rate=0.01,
    layout=FieldLayout(finest=64, log2_rows=12),
    checkpoint_every=20,
)


def shading(raw: Tensor, weights: Tensor) -> Tensor:
    return (weights[..., None] * torch.sigmoid(raw[..., 1:4])).sum(1)


def sphere_views(n: int) -> Views:
    """Cameras around the origin at a distance of 3, that look at it."""
    viewmats = []
    for i in range(n):
        angle = 2 * np.pi * i / n
        forward = -np.array([np.cos(angle), np.sin(angle), 0.4 * (-1) ** i])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        viewmat = np.eye(4)
        viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        viewmat[2, 3] = 3.0
        viewmats.append(viewmat)
    K = torch.tensor([[29.0, 0, 14.2], [0, 27.0, 10.4], [0, 0, 1]])
    return Views(torch.tensor(np.stack(viewmats), dtype=torch.float32), K.expand(n, 3, 3).contiguous(), WIDTH, HEIGHT)


@cache
def ball(n: int = 8) -> tuple[Views, Tensor, Tensor, Tensor]:
    """A ball of radius 1 coloured by its normal before black: views, images, z-depths (0: nothing), points."""
    views = sphere_views(n)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    images, depths = [], []
    for viewmat, K in zip(views.viewmats.double().numpy(), views.Ks.double().numpy(), strict=True):
        local = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T
        b, length = local @ viewmat[:3, 3], (local**2).sum(-1)
        inside = b**2 - length * (viewmat[:3, 3] @ viewmat[:3, 3] - 1)
        z = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / length, 0)
        normals = (local * z[..., None] - viewmat[:3, 3]) @ viewmat[:3, :3]
        images.append(np.where(z[..., None] > 0, 0.5 + 0.4 * normals, 0))
        depths.append(z)
    points = np.random.default_rng(0).normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return (views, *(torch.tensor(np.array(a), dtype=torch.float32) for a in (images, depths)), torch.tensor(points))


def mse(images: Tensor) -> Callable[[Batch], Tensor]:
    return lambda batch: ((shading(batch.raw, batch.weights) - batch.of(images)) ** 2).mean()


def fitted(config: FieldFitConfig, n: int = 8, checkpoint: Path | None = None) -> tuple[FieldFit, Box]:
    views, images, _, points = ball(n)
    box = box_of(views.centers, points)
    return fit_field(views, points, box, mse(images), config, checkpoint=checkpoint), box


def test_a_ball_is_learnt_with_its_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "RAYS", 1000)  # a picture in several parts, views across them
    views, images, depths, _ = ball()
    fit, box = fitted(dataclasses.replace(TINY, iterations=220, rays=512, rate=0.03, near_scale=0.0))
    image, alpha, depth = render_field(fit.state.field, box, fit.state.proposal, views, shading, 24)
    assert -10 * float(((image - images) ** 2).mean().log10()) > 27
    seen = (depths > 0) & (alpha > 0.9)
    assert float(seen.sum() / (depths > 0).sum()) > 0.9
    assert float(((depth - depths).abs()[seen] / depths[seen]).median()) < 0.1
    assert float(alpha[:, 0, 0].max()) < 0.15


def test_a_stopped_run_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    whole, _ = fitted(dataclasses.replace(TINY, iterations=60))
    path = tmp_path / "checkpoint.safetensors"
    views, images, _, points = ball()
    box, loss = box_of(views.centers, points), mse(images)

    def stopping(batch: Batch) -> Tensor:
        if batch.iteration == 45:
            raise KeyboardInterrupt
        return loss(batch)

    config = dataclasses.replace(TINY, iterations=60)
    with pytest.raises(KeyboardInterrupt):
        fit_field(views, points, box, stopping, config, checkpoint=path)
    asked = []

    def counting(batch: Batch) -> Tensor:
        asked.append(batch.iteration)
        return loss(batch)

    resumed = fit_field(views, points, box, counting, config, checkpoint=path)
    assert asked == list(range(40, 60))
    assert whole.earlier == 0 < resumed.earlier < resumed.seconds
    for name, tensor in whole.state.tensors().items():
        assert torch.equal(tensor, resumed.state.tensors()[name]), name
    np.testing.assert_array_equal(whole.state.proposal.density, resumed.state.proposal.density)
    assert [e["loss"] for e in whole.state.losses] == [e["loss"] for e in resumed.state.losses]
    with pytest.raises(ValueError, match=r"belongs to a run with other settings \(rate: 0.01 there, 0.02 now\)"):
        fit_field(views, points, box, loss, dataclasses.replace(config, rate=0.02), checkpoint=path)


def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(b"no tensors")
    with pytest.raises(ValueError, match="is not a training checkpoint of a field .* delete it to start again"):
        fitted(TINY, checkpoint=path)


def test_extra_tensors_are_trained_and_kept(tmp_path: Path) -> None:
    views, images, _, points = ball()
    config, box = dataclasses.replace(TINY, iterations=20), box_of(views.centers, points)

    def trained(iterations: int, path: Path | None) -> Tensor:
        gain = torch.zeros(1)

        def loss(batch: Batch) -> Tensor:
            if batch.iteration == iterations:
                raise KeyboardInterrupt
            return (gain - 3).square().sum() + 0 * batch.raw.sum()

        try:
            fit_field(views, points, box, loss, config, extra={"gain": gain}, checkpoint=path)
        except KeyboardInterrupt:
            trained(99, path)
        return gain.detach()

    whole = trained(99, None)
    assert float(whole) > 0.02
    path = tmp_path / "c.safetensors"
    gain = torch.zeros(1)
    fit_field(
        views, points, box, lambda b: (gain - 3).square().sum() + 0 * b.raw.sum(), config, extra={"gain": gain},
        checkpoint=path,
    )  # fmt: skip
    again = torch.zeros(1)
    fit_field(views, points, box, mse(images), config, extra={"gain": again}, checkpoint=path)
    assert torch.equal(gain.detach(), whole)
    assert torch.equal(again.detach(), whole)


def test_one_view_and_a_camera_inside_the_box_are_fitted() -> None:
    fit, _ = fitted(dataclasses.replace(TINY, iterations=30), n=1)
    assert fit.state.losses[-1]["loss"] < fit.state.losses[0]["loss"]
    views, images, _, points = ball()
    box = box_of(views.centers, 10 * points)  # all cameras are in it
    fit = fit_field(views, 10 * points, box, mse(images), dataclasses.replace(TINY, iterations=30))
    assert fit.state.losses[-1]["loss"] < fit.state.losses[0]["loss"]


def test_a_loss_that_is_not_finite_stops_the_run_and_says_where(tmp_path: Path) -> None:
    views, images, _, points = ball()
    box, path = box_of(views.centers, points), tmp_path / "checkpoint.safetensors"

    def diverging(batch: Batch) -> Tensor:
        return mse(images)(batch) * (float("nan") if batch.iteration == 7 else 1.0)

    with pytest.raises(NotFinite, match=r"the loss must be finite, got nan in step 7: .*leads there again"):
        fit_field(views, points, box, diverging, TINY, checkpoint=path)
    with pytest.raises(NotFinite, match="step 7"):
        fit_field(views, points, box, diverging, TINY, checkpoint=path)


@pytest.mark.parametrize("bad", [16, 17], ids=["looks at the map again", "does not"])
@pytest.mark.parametrize("where", ["loss", "gradient"])
def test_what_a_bad_step_leaves_is_the_state_before_it(tmp_path: Path, bad: int, where: str) -> None:
    """Gone on from with a loss that is fine, it gives the bits of a run that never was wrong."""
    views, images, _, points = ball()
    box, path, config = box_of(views.centers, points), tmp_path / "c", dataclasses.replace(TINY, iterations=24)
    fine = mse(images)

    def wrong(batch: Batch) -> Tensor:
        value, zero = fine(batch), (batch.raw - batch.raw.detach()).abs().sum()
        if batch.iteration != bad:
            return value
        return value * float("nan") if where == "loss" else value + zero.sqrt()  # finite, its slope is 0 / 0

    with pytest.raises(NotFinite, match=f"the {where} must be finite.* in step {bad}"):
        fit_field(views, points, box, wrong, config, checkpoint=path)
    mended = fit_field(views, points, box, fine, config, checkpoint=path).state
    whole = fit_field(views, points, box, fine, config).state
    np.testing.assert_array_equal(mended.proposal.density, whole.proposal.density)
    assert (mended.looked, mended.steps) == (whole.looked, whole.steps)
    assert all(torch.equal(tensor, mended.tensors()[name]) for name, tensor in whole.tensors().items())


def test_the_map_is_looked_at_cell_after_cell_and_then_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[np.ndarray] = []

    def learn(places: np.ndarray, *given: object) -> None:
        x, y, z = (places * SIDE).astype(int).T
        seen.append((z * SIDE + y) * SIDE + x)

    monkeypatch.setattr(fitting, "evaluate", lambda field, places, basis: (np.zeros((len(places), 1)), None))
    state = SimpleNamespace(looked=0, field=None, proposal=SimpleNamespace(learn=learn))
    rng = SimpleNamespace(random=lambda shape: np.full(shape, 0.5))  # at the middle of cells
    for _ in range(3):
        fitting.refresh(state, rng, 400_000)
    np.testing.assert_array_equal(np.concatenate(seen), np.arange(1_200_000) % SIDE**3)
    assert state.looked == 1_200_000 % SIDE**3


def test_the_map_keeps_nine_tenths_of_its_excess_where_rays_meet_it_and_half_where_it_is_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    views, images, _, points = ball()
    box, learnt, real = box_of(views.centers, points), [], Proposal.learn
    monkeypatch.setattr(Proposal, "learn", lambda self, *given: learnt.append(given[:2]) or real(self, *given))
    state = fit_field(views, points, box, mse(images), dataclasses.replace(TINY, iterations=1)).state
    density = np.where(cells_near(points, box), 10.0, 0.05)
    (looked, _), (met, _) = learnt
    assert len(looked) == TINY.rays * TINY.samples // 2
    assert len(met) == TINY.rays * TINY.samples
    for (places, logarithms), kept in zip(learnt, (0.5, 0.9), strict=True):
        for (x, y, z), found in zip((places * SIDE).astype(int).clip(0, SIDE - 1), np.exp(logarithms), strict=True):
            at = (z * SIDE + y) * SIDE + x
            density[at] = max(found, found + kept * (density[at] - found))
    np.testing.assert_allclose(state.proposal.density, density, rtol=1e-4)


def test_the_rate_rises_in_the_first_steps_and_then_falls_by_one_factor_a_step() -> None:
    config = FieldFitConfig(iterations=100, rate=0.01, rate_end=0.01, warm=4)
    found = [config.rate_at(i) for i in (0, 1, 3, 50, 100)]
    assert found == pytest.approx([0.0025, 0.005 * 10**-0.02, 0.01 * 10**-0.06, 0.001, 0.0001])
    assert dataclasses.replace(config, warm=0).rate_at(0) == 0.01


def test_a_field_without_views_is_refused() -> None:
    views, images, _, points = ball()
    none = Views(views.viewmats[:0], views.Ks[:0], WIDTH, HEIGHT)
    with pytest.raises(ValueError, match="at least one view on the CPU, got 0"):
        fit_field(none, points, box_of(views.centers, points), mse(images), TINY)


def test_gradients_fall_with_the_square_of_the_distance_before_near_scale_and_nowhere_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    views, _, _, points = ball()
    box, distances, told, real = box_of(views.centers, points), [], [], fitting.gradients
    monkeypatch.setattr(fitting, "gradients", lambda *given: told.append(given[-1].copy()) or real(*given))

    def first_colour(batch: Batch) -> Tensor:
        distances.append(batch.samples.distances)
        return batch.raw[..., 1].sum()

    config = dataclasses.replace(TINY, iterations=1, distortion=0.0, near_scale=0.5)
    fit_field(views, points, box, first_colour, config)
    want = torch.clamp_max((distances[0] / (0.5 * box.middle)) ** 2, 1).flatten()
    assert 0.1 < float((want < 1).float().mean()) < 0.9
    np.testing.assert_allclose(told[0][:, 1], want, rtol=1e-6)


def test_the_distortion_takes_places_and_widths_in_one_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    views, images, _, points = ball()
    seen, real = [], fitting.distortion
    monkeypatch.setattr(fitting, "distortion", lambda *given: seen.append(given) or real(*given))
    fit_field(views, points, box_of(views.centers, points), mse(images), dataclasses.replace(TINY, iterations=1))
    _, along, widths = seen[0]
    inside = along[:, 1:] < 0.99  # a sample lies in the middle of its interval
    between = (widths[:, 1:] + widths[:, :-1]) / 2
    torch.testing.assert_close(along.diff(dim=1)[inside], between[inside], rtol=1e-3, atol=1e-6)


def test_the_seed_varies_the_field_at_the_start_and_the_pixels_of_every_step() -> None:
    seeds = (0, 0, 1)
    start = [fitted(dataclasses.replace(TINY, iterations=1, rate=1e-12, seed=seed))[0] for seed in seeds]
    first, again, other = (torch.cat([t.flatten() for t in fit.state.field.tensors().values()]) for fit in start)
    assert torch.equal(first, again)
    assert float((first - other).abs().max()) > 1e-6  # much more than the step
    seen: dict[int, list[Tensor]] = {seed: [] for seed in seeds}
    views, images, _, points = ball()
    box, loss = box_of(views.centers, points), mse(images)
    for seed in seen:

        def watched(batch: Batch, seed: int = seed) -> Tensor:
            seen[seed].append(batch.of(images).clone())
            return loss(batch)

        fit_field(views, points, box, watched, dataclasses.replace(TINY, iterations=2, seed=seed))
    drawn = [step for steps in seen.values() for step in steps]
    assert not any(torch.equal(a, b) for i, a in enumerate(drawn) for b in drawn[:i])


@pytest.mark.parametrize("what", ["viewmats", "Ks", "width", "height", "points", "box", "extra", "settings"])
def test_a_checkpoint_of_any_other_input_is_refused(what: str, tmp_path: Path) -> None:
    views, images, _, points = ball()
    box, config, path = (
        box_of(views.centers, points),
        dataclasses.replace(TINY, iterations=1),
        tmp_path / "c.safetensors",
    )
    extra = {"a": torch.zeros(3)}
    fit_field(views, points, box, mse(images), config, checkpoint=path, extra=extra)
    K = torch.tensor([[1.01, 0, 0], [0, 1, 0], [0, 0, 1]])
    turn = torch.diag(torch.tensor([-1.0, -1.0, 1.0, 1.0]))
    changed = {
        "viewmats": {"views": dataclasses.replace(views, viewmats=views.viewmats @ turn)},
        "Ks": {"views": dataclasses.replace(views, Ks=views.Ks @ K)},
        "width": {"views": dataclasses.replace(views, width=views.width - 1)},
        "height": {"views": dataclasses.replace(views, height=views.height - 1)},
        "points": {"points": points[1:]},
        "box": {"box": box_of(1.1 * views.centers, points)},
        "extra": {"extra": {"a": torch.ones(3)}},
        "settings": {"config": dataclasses.replace(config, rate=0.5)},
    }[what]
    given = {"views": views, "points": points, "box": box, "config": config, "extra": extra} | changed
    with pytest.raises(ValueError, match="belongs to a run with other settings"):
        fit_field(
            given["views"], given["points"], given["box"], mse(images), given["config"], checkpoint=path,
            extra=given["extra"],
        )  # fmt: skip


def test_the_decay_of_the_tables_is_the_gradient_of_each_levels_mean_square_and_shrinks_them() -> None:
    layout = FieldLayout(finest=64, log2_rows=14)
    made = first_field(layout, 0)
    table = made.table.clone().double().requires_grad_()
    levels = [table[a:b] for a, b in zip(layout.starts[:-1], layout.starts[1:], strict=True)]
    assert len({len(level) for level in levels}) > 1
    (0.7 * torch.stack([level.square().mean() for level in levels]).mean()).backward()
    assert table.grad is not None
    np.testing.assert_allclose(fitting.table_decay_slope(made, 0.7), table.grad.numpy(), rtol=1e-5)
    views, images, _, points = ball()
    box, config = box_of(views.centers, points), dataclasses.replace(TINY, iterations=60)
    norms = [
        fit_field(
            views, points, box, mse(images), dataclasses.replace(config, table_decay=weight)
        ).state.field.table.norm()
        for weight in (0.0, 10.0)
    ]
    assert norms[1] < 0.7 * norms[0]
