"""What a denoiser step computes, with the network replaced by simple functions whose outcome can be worked out."""

import math
from typing import get_args

import numpy as np
import pytest
import torch

from novags.methods.nova import denoiser as module
from novags.methods.nova.denoiser import Denoiser, donut_blur
from novags.methods.nova.denoiser_config import BlindSpotConfig, DenoiserConfig, ResUNetConfig
from novags.methods.nova.packed import packed, turned
from novags.splats.training.flags import Flags
from sensor_model.params import Cfa

TINY = ResUNetConfig(widths=(4,), bottleneck=4, normalization="none")


def views(count: int = 3, height: int = 6, width: int = 5) -> torch.Tensor:
    """Random images [C, H, W, 3] in 0..1."""
    return torch.rand(count, height, width, 3, generator=torch.Generator().manual_seed(0))


def denoiser(images: torch.Tensor, *, total_steps: int = 10, seed: int = 0, **changes) -> Denoiser:
    return Denoiser(images, DenoiserConfig(**{"network": TINY, **changes}), total_steps=total_steps, seed=seed)


def test_the_published_schedule_is_the_default():
    config = DenoiserConfig()
    assert (config.denoise_every, config.batch, config.crop, config.learning_rate) == (1, 1, None, 1e-3)
    assert config.warmup_steps == 500


@pytest.mark.parametrize(("size", "sigma", "radius"), [((9, 12), 0.8, 3), ((7, 6), 0.3, 1), ((3, 8), 1.5, 2)])
def test_the_donut_blur_equals_its_sum(size, sigma, radius):
    image = np.random.default_rng(0).uniform(0, 1, (2, *size))
    padded = np.pad(image, ((0, 0), (radius, radius), (radius, radius)), mode="reflect")
    offsets = [(dy, dx) for dy in range(-radius, radius + 1) for dx in range(-radius, radius + 1) if (dy, dx) != (0, 0)]
    weights = [math.exp(-(dy**2 + dx**2) / (2 * sigma**2)) for dy, dx in offsets]
    expected = np.empty_like(image)
    for c, y, x in np.ndindex(image.shape):
        around = [padded[c, y + radius + dy, x + radius + dx] for dy, dx in offsets]
        expected[c, y, x] = np.dot(weights, around) / sum(weights)
    np.testing.assert_allclose(donut_blur(torch.from_numpy(image)[None], sigma)[0], expected, rtol=1e-9)


def test_the_denoised_image_is_the_networks_output_for_that_view_clipped():
    images = views()
    for share in (0.0, 0.25):
        subject = denoiser(images, noisy_share=share)
        subject.network = lambda x: 2 * x - 0.5
        clean = (2 * images - 0.5).clamp(0, 1)
        assert (clean == 0).any()
        assert (clean == 1).any()
        for view in range(3):
            torch.testing.assert_close(subject.denoise(view), (1 - share) * clean[view] + share * images[view])
        torch.testing.assert_close(subject.denoise_all(), (1 - share) * clean + share * images)


def test_a_residual_network_adds_to_the_blur():
    images = views(1, 9, 9)
    subject = denoiser(images, residual_blur=0.7)
    subject.network = lambda x: 0.1 * x
    planes = images.movedim(-1, 1)
    torch.testing.assert_close(subject.predict(planes), 0.1 * planes + donut_blur(planes, 0.7))


@pytest.mark.parametrize(("per_channel", "expected"), [(False, 3 * 2.25), (True, 2.25)])
def test_the_loss_compares_the_prediction_for_the_blinded_image_with_the_noisy_one(monkeypatch, per_channel, expected):
    seen = {}

    def sample(planes, fraction, share, generator):
        seen.update(shape=planes.shape, fraction=fraction, share=share)
        return torch.ones(len(planes), *planes.shape[-2:], dtype=torch.bool)

    def replace(planes, mask, window, generator):
        seen.update(window=window)
        return planes + 1

    monkeypatch.setattr(module, "sample_mask", sample)
    monkeypatch.setattr(module, "replace_masked", replace)
    spots = BlindSpotConfig(mask_count=None, mask_fraction=0.2, laplacian_share=0.7, window=7, per_channel=per_channel)
    subject = denoiser(views(), batch=2, crop=4, blind_spots=spots)
    subject.network = lambda x: x + 0.5
    # prediction - noisy = (noisy + 1 + 0.5) - noisy in every channel
    assert float(subject.loss()) == pytest.approx(expected, rel=1e-5)
    assert seen["shape"] == ((6, 1, 4, 4) if per_channel else (2, 3, 4, 4))
    assert (seen["fraction"], seen["share"], seen["window"]) == (0.2, 0.7, 7)


def test_a_channel_blinded_alone_is_found_where_it_was_put(monkeypatch):
    """Rationale: planes are taken apart for the masks and put together for the network; nothing may change places."""
    monkeypatch.setattr(module, "replace_masked", lambda planes, *rest: planes)
    subject = denoiser(views(), batch=2, blind_spots=BlindSpotConfig(per_channel=True))
    inputs = []
    subject.network = lambda x: inputs.append(x) or x
    assert float(subject.loss()) == 0
    known = subject.images
    assert all(any(torch.equal(picture, view) for view in known) for picture in inputs[0])


def test_the_share_of_a_view_holds_for_its_crops(monkeypatch):
    seen = []
    original = module.sample_mask
    monkeypatch.setattr(module, "sample_mask", lambda p, f, *rest: seen.append(f) or original(p, f, *rest))
    denoiser(views(1, 20, 10), crop=8, blind_spots=BlindSpotConfig(mask_count=20, mask_fraction=0.5)).loss()
    assert seen == [20 / 200]


def test_crops_lie_anywhere_inside_any_view():
    images = torch.arange(2 * 4 * 5, dtype=torch.float32).reshape(2, 4, 5, 1).expand(-1, -1, -1, 3)
    subject = denoiser(images, crop=3, batch=2)
    corners = set()
    for _ in range(200):
        for crop in subject._draw_batch():
            view, top, left = (int(i) for i in np.unravel_index(int(crop[0, 0, 0]), (2, 4, 5)))
            assert torch.equal(crop, images[view, top : top + 3, left : left + 3].movedim(-1, 0))
            corners.add((view, top, left))
    assert corners == {(v, y, x) for v in range(2) for y in range(2) for x in range(3)}


@pytest.mark.parametrize("augment", [False, True])
def test_augmentation_shows_all_eight_orientations_and_its_absence_one(augment):
    image = torch.arange(16.0).reshape(1, 4, 4, 1).expand(-1, -1, -1, 3)
    subject = denoiser(image, augment=augment)
    seen = {tuple(subject._draw_batch()[0, 0].flatten().tolist()) for _ in range(150)}
    plane = image[0, ..., 0].numpy()
    turned = {tuple(np.rot90(p, k).ravel().tolist()) for p in (plane, plane.T) for k in range(4)}
    assert seen == (turned if augment else {tuple(plane.ravel().tolist())})


def test_a_step_is_one_of_adam_at_the_configured_rate():
    """Rationale: Adam's first step moves every parameter that has a gradient by the rate, whatever the gradient."""
    subject = denoiser(views(), learning_rate=2e-3)
    before = [p.detach().clone() for p in subject.network.parameters()]
    generator = subject.generator.get_state()
    expected = subject.loss().item()
    subject.generator.set_state(generator)
    assert subject.train_step() == pytest.approx(expected)
    moves = [(p.detach() - b).abs() for p, b in zip(subject.network.parameters(), before, strict=True)]
    assert max(float(m.max()) for m in moves) == pytest.approx(2e-3, rel=1e-2)
    assert np.median(torch.cat([m.flatten() for m in moves]).numpy()) == pytest.approx(2e-3, rel=1e-2)
    assert subject.step == 1
    assert all(p.grad is None for p in subject.network.parameters())


def test_steps_lead_downhill():
    subject = denoiser(views(1, 12, 12), learning_rate=1e-2, blind_spots=BlindSpotConfig(mask_fraction=0.5))
    losses = [subject.train_step() for _ in range(40)]
    assert sum(losses[-5:]) < 0.7 * sum(losses[:5])


def test_the_cosine_falls_from_the_full_rate_to_zero_and_stays_there():
    subject = denoiser(views(), total_steps=4, decay="cosine", learning_rate=1e-2)
    rates = []
    for _ in range(6):
        subject.train_step()
        rates.append(subject.optimizer.param_groups[0]["lr"])
    half = 0.5 * (1 + math.cos(math.pi / 4))
    np.testing.assert_allclose(rates, [1e-2, half * 1e-2, 5e-3, (1 - half) * 1e-2, 0, 0], atol=1e-12)


def test_a_denoiser_that_never_trains_may_still_be_asked_for_a_step():
    subject = denoiser(views(), total_steps=0, decay="cosine")
    subject.train_step()
    assert subject.optimizer.param_groups[0]["lr"] == 1e-3


@pytest.mark.parametrize("flags", [None, Flags(torch.device("cpu"))], ids=["on a CPU", "as on a GPU"])
def test_another_seed_is_another_network_and_other_batches(flags):
    images = views(8)
    first, second = (
        Denoiser(images, DenoiserConfig(network=TINY), total_steps=10, seed=s, flags=flags) for s in (1, 2)
    )
    assert not torch.equal(first.network.head.weight, second.network.head.weight)
    batches = [torch.cat([d._draw_batch() for _ in range(8)]) for d in (first, second)]
    assert not torch.equal(*batches)


def test_the_images_are_kept_without_gradient():
    images = views().requires_grad_()
    assert not denoiser(images).images.requires_grad


def test_a_restored_step_count_and_random_stream_are_those_saved():
    subject, other = denoiser(views(), seed=1), denoiser(views(), seed=2)
    subject.train_step()
    other.restore(subject.state())
    assert other.step == 1
    assert torch.equal(other.generator.get_state(), subject.generator.get_state())
    for a, b in zip(subject.network.parameters(), other.network.parameters(), strict=True):
        assert torch.equal(a, b)


def test_gradients_that_wait_are_saved_with_the_network():
    subject, other = denoiser(views(), seed=1), denoiser(views(), seed=2)
    subject.train_step()
    subject.denoise(0).sum().backward()
    other.restore({name: tensor.clone() for name, tensor in subject.state().items()})
    subject.train_step()
    other.train_step()
    for a, b in zip(subject.network.parameters(), other.network.parameters(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("turn", range(8))
@pytest.mark.parametrize("cfa", get_args(Cfa))
def test_turned_samples_are_those_of_a_turned_picture_cut_where_its_pattern_begins(cfa: Cfa, turn: int) -> None:
    """Of a picture that holds its channel in every sample, red stays red."""
    picture = torch.rand(8, 10, generator=torch.Generator().manual_seed(1))[..., None] * 0.9 + torch.arange(3.0)
    found = turned(packed(picture[None], cfa), turn, cfa)[0]
    moved = picture.rot90(turn % 4, (0, 1))
    moved = moved.flip(1) if turn >= 4 else moved
    cut = [moved[y : moved.shape[0] - y, x : moved.shape[1] - x] for y in (0, 1) for x in (0, 1)]
    shown = [packed(each[None], cfa)[0] for each in cut]
    letters = torch.tensor(["RGB".index(letter) for letter in cfa])
    assert torch.equal(found.floor(), letters[:, None, None].expand_as(found).float())
    assert any(found.shape == each.shape and torch.equal(found, each) for each in shown)
