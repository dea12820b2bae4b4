"""What the fit is given: targets, start, losses and schedule, with the fit and the denoiser's network replaced.

The stand-in denoiser gives 0.6 of the enhanced picture plus 0.01 per step, so every number can be worked out.
"""

import dataclasses
import time
from types import SimpleNamespace

import pytest
import torch

from novags.methods.enhancers.guided import enhance
from novags.methods.nova import trainer
from novags.methods.nova.config import ConsistencyConfig, NovaConfig
from novags.methods.nova.consistency import ConsistencyLoss
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import DenoiserConfig, ResUNetConfig
from novags.methods.nova.sh_penalty import penalty_weights
from novags.methods.nova.trainer import _PseudoClean, run_identity, train
from novags.methods.problem import Problem
from novags.splats import FitConfig, Views
from novags.splats.training.config import CameraRefinement
from novags.splats.training.fit import FitResult
from novags.splats.training.step import harmonics_penalty

HEIGHT, WIDTH, COUNT, WARM_UP, ITERATIONS = 8, 10, 3, 2, 6
DENOISER = DenoiserConfig(
    network=ResUNetConfig(widths=(4,), bottleneck=4, normalization="none"), warmup_steps=WARM_UP, denoise_every=2
)
CONFIG = NovaConfig(
    denoiser=DENOISER, consistency=ConsistencyConfig(start=0.0, max_angle=60), sh_weight=0.7, init_scale=0.3,
    fit=FitConfig(iterations=ITERATIONS, sh_degree=1, checkpoint_every=3),
)  # fmt: skip


def changed(**changes) -> NovaConfig:
    return dataclasses.replace(CONFIG, **changes)


def problem(**changes) -> Problem:
    g = torch.Generator().manual_seed(1)
    viewmats = torch.eye(4).repeat(COUNT, 1, 1)
    viewmats[:, 0, 3], viewmats[:, 2, 3] = torch.linspace(-0.4, 0.4, COUNT), 3.0
    K = torch.tensor([[10.0, 0, WIDTH / 2], [0, 10.0, HEIGHT / 2], [0, 0, 1]])
    dark = 0.05 + 0.2 * torch.rand(COUNT, HEIGHT, WIDTH, 3, generator=g)
    start = SimpleNamespace(points=torch.rand(30, 3, generator=g), colors=torch.rand(30, 3, generator=g), extent=1.7)
    values = {"views": Views(viewmats, K.repeat(COUNT, 1, 1), WIDTH, HEIGHT), "srgb8": dark, "start": start, "seed": 5}
    return Problem(**{**values, **changes})


class Stage:
    """Everything that a run hands over, and what it did while the fit asked for its steps."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.log: list[str] = []
        self.seen: dict[str, object] = {}
        self.denoisers: list[Denoiser] = []
        self.during = lambda: None
        original = Denoiser.__init__

        def create(denoiser: Denoiser, *args, **keywords) -> None:
            original(denoiser, *args, **keywords)
            self.denoisers.append(denoiser)
            self.seen["total_steps"], self.seen["denoiser seed"] = keywords["total_steps"], keywords["seed"]

        def learn(denoiser: Denoiser) -> float:
            denoiser.step += 1
            self.log.append("denoiser")
            return 0.25

        monkeypatch.setattr(Denoiser, "__init__", create)
        monkeypatch.setattr(Denoiser, "train_step", learn)
        monkeypatch.setattr(Denoiser, "denoise", lambda d, view: clean(d.images[view].movedim(0, -1), d.step))
        monkeypatch.setattr(ConsistencyLoss, "update", lambda geo: self.log.append("confidence"))
        monkeypatch.setattr(trainer, "fit", self.fit)
        start = trainer.start_gaussians

        def first(init, dark, images, **keywords):
            self.seen["start"] = (init, dark, images.clone()), keywords  # the images change later
            return start(init, dark, images, **keywords)

        monkeypatch.setattr(trainer, "start_gaussians", first)

    def fit(self, gaussians, views, target, config, **keywords) -> FitResult:
        self.seen.update(gaussians=gaussians, views=views, target=target, config=config, **keywords)
        for iteration in range(config.iterations):
            keywords["before_step"](iteration)
            self.log.append("splats")
        self.during()
        moved = views.viewmats + 1
        return FitResult(
            gaussians=gaussians, viewmats=moved, config=config, losses=[{"iteration": 6.0}], seconds=1.5, peak_bytes=0
        )  # fmt: skip


def clean(enhanced: torch.Tensor, step: int) -> torch.Tensor:
    return 0.6 * enhanced + 0.01 * step


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    return Stage(monkeypatch)


def bright(inputs: Problem) -> torch.Tensor:
    return torch.stack([enhance(picture)[0] for picture in inputs.srgb8])


def test_the_fit_aims_at_the_denoised_image_of_each_view_as_it_stands(stage):
    inputs, targets = problem(), []
    stage.during = lambda: targets.extend(stage.seen["target"](view) for view in range(COUNT))
    result = train(inputs, CONFIG)
    expected = clean(bright(inputs), WARM_UP + ITERATIONS // 2)
    torch.testing.assert_close(torch.stack(targets), expected)
    torch.testing.assert_close(result.targets, expected)
    torch.testing.assert_close(result.enhanced, bright(inputs))
    assert stage.seen["views"] is inputs.views


def test_gaussians_start_at_the_points_in_the_colours_of_the_denoised_images(stage):
    inputs = problem()
    result = train(inputs, CONFIG)
    (start, dark, images), keywords = stage.seen["start"]
    assert start is inputs.start
    assert torch.equal(dark, inputs.srgb8)
    torch.testing.assert_close(images, clean(bright(inputs), WARM_UP))
    assert keywords == {"sh_degree": 1, "init_scale": 0.3}
    assert result.scene.gaussians is stage.seen["gaussians"]


def test_networks_learn_in_turn_with_the_splats(stage):
    train(problem(), CONFIG)
    # ceil(i / 2) concurrent steps are due by iteration i: after 0, 2, 4 and so before 1, 3, 5
    step = ["confidence", "splats", "confidence", "denoiser", "splats"]
    assert stage.log == ["denoiser"] * WARM_UP + step * 3 + ["confidence"]
    assert stage.seen["total_steps"] == WARM_UP + 3
    assert stage.seen["denoiser seed"] == 5


def test_the_noise_penalty_weighs_each_view_by_its_own_residual(stage):
    inputs, found = problem(), []
    g = torch.Generator().manual_seed(3)
    sh = torch.rand(20, 4, 3, generator=g)
    means2d = torch.rand(20, 2, generator=g) * torch.tensor([float(WIDTH), float(HEIGHT)])
    info, seen = {"means2d": means2d[None]}, torch.ones(20, dtype=torch.bool)

    def ask() -> None:
        penalty = stage.seen["extra_losses"][1]
        for view in (0, 1, 2, 1):
            found.append(
                float(penalty(SimpleNamespace(view=view, gaussians=SimpleNamespace(sh=sh), info=info, visible=seen)))
            )

    stage.during = ask
    train(inputs, CONFIG)
    images = bright(inputs)
    noise = (images - clean(images, WARM_UP + 3)).abs().mean(-1)
    weights = [penalty_weights(means2d, seen, noise[view]) for view in (0, 1, 2, 1)]
    expected = [0.7 * float(harmonics_penalty(sh, w)) for w in weights]
    assert len(set(expected)) == 3
    assert found == pytest.approx(expected, rel=1e-5)


def test_the_noise_map_follows_the_denoiser(stage):
    inputs, weights = problem(), []
    sh, info, seen = torch.ones(1, 4, 3), {"means2d": torch.tensor([[[0.5, 0.5]]])}, torch.tensor([True])

    def ask() -> None:
        for _ in range(2):
            step = SimpleNamespace(view=1, gaussians=SimpleNamespace(sh=sh), info=info, visible=seen)
            weights.append(float(stage.seen["extra_losses"][1](step)) / (0.7 * 9))
            stage.denoisers[0].step += 5

    stage.during = ask
    train(inputs, CONFIG)
    picture = bright(inputs)[1, 0, 0]
    expected = [float((picture - clean(picture, WARM_UP + 3 + more)).abs().mean()) for more in (0, 5)]
    assert weights == pytest.approx(expected, rel=1e-4)


def test_the_geometric_loss_compares_denoised_images(stage):
    inputs, images = problem(), []
    stage.during = lambda: images.extend(stage.seen["extra_losses"][0].images(view) for view in range(COUNT))
    train(inputs, CONFIG)
    geo = stage.seen["extra_losses"][0]
    assert isinstance(geo, ConsistencyLoss)
    assert (geo.seed, geo.first, geo.config) == (5, 0, CONFIG.consistency)
    torch.testing.assert_close(torch.stack(images), clean(bright(inputs), WARM_UP + 3))
    assert stage.seen["needs_depth"] == geo.due
    late = changed(consistency=ConsistencyConfig(start=0.5))
    train(inputs, late)
    assert stage.seen["extra_losses"][0].first == ITERATIONS // 2


@pytest.mark.parametrize("off", [None, ConsistencyConfig(weight=0.0)])
def test_without_its_weight_there_is_no_geometric_loss_and_no_depth(stage, off):
    train(problem(), changed(consistency=off))
    assert not any(isinstance(loss, ConsistencyLoss) for loss in stage.seen["extra_losses"])
    assert stage.seen["needs_depth"] is False
    assert "confidence" not in stage.log


def test_without_a_denoiser_the_fit_aims_at_the_enhanced_images(stage):
    inputs, targets = problem(), []
    stage.during = lambda: targets.extend(stage.seen["target"](view) for view in range(COUNT))
    result = train(inputs, changed(denoiser=None, sh_weight=None))
    assert torch.equal(torch.stack(targets), bright(inputs))
    assert torch.equal(result.targets, result.enhanced)
    assert "denoiser" not in stage.log
    assert [type(loss) for loss in stage.seen["extra_losses"]] == [ConsistencyLoss]


def test_the_seed_and_extent_of_the_problem_reach_the_fit_and_the_record(stage):
    result = train(problem(), CONFIG)
    expected = dataclasses.replace(CONFIG.fit, seed=5, extent=1.7)
    assert stage.seen["config"] == expected
    assert result.config.fit == expected
    assert result.space == "enhanced"
    assert result.enhancement["pictures"] == "8bit"
    assert result.losses == [{"iteration": 6.0}]
    assert result.seconds["fit"] == 1.5


def test_refined_cameras_are_given_back_where_they_were_asked_for(stage):
    inputs = problem()
    assert train(inputs, CONFIG).viewmats is None
    refined = train(inputs, changed(fit=dataclasses.replace(CONFIG.fit, refine_cameras=CameraRefinement())))
    assert torch.equal(refined.viewmats, inputs.views.viewmats + 1)


def test_progress_counts_warm_up_and_splats_together(stage):
    seen = []
    train(problem(), CONFIG, progress=lambda *entry: seen.append(entry))
    assert [entry[:2] for entry in seen] == [(1, WARM_UP + ITERATIONS), (2, WARM_UP + ITERATIONS)]
    assert seen[0][2] == {"denoiser": 0.25}
    stage.seen["progress"](4, ITERATIONS, {"loss": 1.0})
    assert seen[-1][:2] == (WARM_UP + 4, WARM_UP + ITERATIONS)
    weights = torch.cat([p.detach().flatten().double() for p in stage.denoisers[0].network.parameters()])
    norms = {
        "norm_denoiser": pytest.approx(float(weights.norm()), rel=1e-5),
        "norm_confidence": pytest.approx(3, abs=3),
    }
    assert seen[-1][2] == {"loss": 1.0, **norms}


def test_seconds_are_those_that_passed(stage):
    started = time.perf_counter()
    seconds = train(problem(), CONFIG).seconds
    assert 0 < seconds["enhance"] + seconds["denoise"] < time.perf_counter() - started


def test_a_run_without_progress_passes_none_on(stage):
    train(problem(), CONFIG)
    assert stage.seen["progress"] is None


def test_networks_are_saved_when_the_fit_is_and_at_both_ends(stage, tmp_path, monkeypatch):
    moments = []
    original = trainer.write_tensors
    monkeypatch.setattr(trainer, "write_tensors", lambda *a: moments.append(stage.log.count("splats")) or original(*a))
    train(problem(), CONFIG, checkpoint=tmp_path / "run.safetensors")
    assert moments == [0, 3, 6]
    assert stage.seen["checkpoint"] == tmp_path / "run.safetensors"
    assert (tmp_path / "run.denoiser.safetensors").exists()


def held(refresh_after: int) -> tuple[_PseudoClean, SimpleNamespace]:
    images = torch.rand(2, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    scale = torch.ones((), requires_grad=True)
    denoiser = SimpleNamespace(step=0, denoise=lambda view: clean(images[view], denoiser.step) * scale)
    return _PseudoClean(images, denoiser, changed(refresh_after=refresh_after)), denoiser


def test_an_image_is_kept_for_that_many_denoiser_steps():
    held_images, denoiser = held(3)
    ages = []
    for denoiser.step in range(8):
        image = held_images(1)
        found = [s for s in range(8) if torch.equal(image, clean(held_images.enhanced[1], s))]
        ages.append(found[0])
        assert not image.requires_grad
    assert ages == [0, 0, 0, 3, 3, 3, 6, 6]


def test_memory_of_images_that_will_all_be_made_anew_is_given_back():
    """Rationale: the images of 43 views of 1 Mpx stayed beside the maps of the network, half a gigabyte."""
    held_images, denoiser = held(1)
    before = held_images.images
    held_images(0), held_images(1)
    assert held_images.images is before
    denoiser.step = 1
    torch.testing.assert_close(held_images(1), clean(held_images.enhanced[1], 1))
    assert held_images.images is not before
    assert held_images.steps == {1: 1}
    second = held_images.images
    held_images(0)
    assert held_images.images is second  # both are of one network
    torch.testing.assert_close(held_images.all_now(), torch.stack([clean(each, 1) for each in held_images.enhanced]))
    older, denoiser = held(3)
    before = older.images
    for denoiser.step in range(5):
        older(0)
    assert older.images is before


@pytest.mark.parametrize(("every", "left"), [(1, 0), (3, 0), (None, COUNT)])
def test_all_images_are_let_go_before_the_fit_where_the_network_learns_on(every, left, stage):
    """Rationale: its next step came beside the images of all views, which it makes worthless."""
    config, inputs = changed(denoiser=dataclasses.replace(DENOISER, denoise_every=every)), problem()
    training = trainer._Training(inputs, bright(inputs), config, None)
    training.warm_up(inputs, None)
    assert len(training.clean.steps) == left
    torch.testing.assert_close(training.clean(1), clean(training.enhanced[1], training.denoiser.step))


def test_only_an_image_that_is_not_detached_lets_gradients_into_the_denoiser():
    held_images, denoiser = held(1)
    assert not held_images.target(0).requires_grad
    held_images.config = changed(detach_target=False)
    target = held_images.target(1)
    assert target.requires_grad
    torch.testing.assert_close(target.detach(), clean(held_images.enhanced[1], 0))


def test_only_images_that_may_be_stale_are_saved_and_they_come_back():
    assert held(1)[0].state() == {}
    first, denoiser = held(3)
    denoiser.step = 4
    image = first(1)
    second, other = held(3)
    second.restore({**first.state(), "denoiser.steps": torch.tensor(4)})
    other.step = 6
    assert torch.equal(second(1), image)
    other.step = 7
    assert not torch.equal(second(1), image)


def test_the_identity_of_a_run_depends_on_everything_it_is_given():
    inputs = problem()
    base = run_identity(inputs, CONFIG)
    assert base.dtype == torch.uint8
    assert torch.equal(base, run_identity(problem(), CONFIG))
    views, start = inputs.views, inputs.start
    others = [
        problem(views=dataclasses.replace(views, viewmats=views.viewmats * 1.01)),
        problem(views=dataclasses.replace(views, Ks=views.Ks * 1.01)),
        problem(srgb8=inputs.srgb8 * 0.99),
        problem(seed=6),
        problem(start=SimpleNamespace(points=start.points + 1, colors=start.colors, extent=start.extent)),
        problem(start=SimpleNamespace(points=start.points, colors=1 - start.colors, extent=start.extent)),
        problem(start=SimpleNamespace(points=start.points, colors=start.colors, extent=2.0)),
    ]
    identities = [run_identity(other, CONFIG) for other in others] + [run_identity(inputs, changed(sh_weight=0.8))]
    assert not any(torch.equal(base, other) for other in identities)


@pytest.mark.parametrize(("asked", "share", "used"), [(None, (), True), (None, ("JPEG",), False), (False, (), False)])
def test_channels_are_blinded_alone_only_where_their_noise_is_independent(stage, asked, share, used):
    spots = dataclasses.replace(DENOISER.blind_spots, per_channel=asked)
    config = changed(denoiser=dataclasses.replace(DENOISER, blind_spots=spots))
    result = train(problem(channels_share=share), config)
    assert result.config.denoiser.blind_spots.per_channel is used


def test_blinding_channels_that_share_their_noise_is_refused():
    spots = dataclasses.replace(DENOISER.blind_spots, per_channel=True)
    config = changed(denoiser=dataclasses.replace(DENOISER, blind_spots=spots))
    with pytest.raises(ValueError, match="demosaicing and JPEG"):
        train(problem(channels_share=("demosaicing", "JPEG")), config)


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"sh_weight": 0.0}, "sh_weight must be > 0"),
        ({"denoiser": None}, "no effect without a denoiser"),
        ({"detach_target": False, "denoiser": dataclasses.replace(DENOISER, denoise_every=None)}, "detach_target"),
    ],
)
def test_settings_without_effect_are_refused(wrong, match):
    with pytest.raises(ValueError, match=match):
        changed(**wrong)


def test_the_targets_of_a_run_are_of_the_last_denoiser_and_no_view_is_denoised_twice():
    pseudo, denoiser = held(refresh_after=100)
    asked = []
    denoise = denoiser.denoise
    denoiser.denoise = lambda view: asked.append(view) or denoise(view)
    pseudo(0)
    denoiser.step += 1
    pseudo(1)
    asked.clear()
    found = pseudo.all_now()
    assert asked == [view for view in range(len(found)) if view != 1]
    for view, image in enumerate(found):
        assert torch.equal(image, denoise(view))
