import math
from contextlib import contextmanager

import pytest
import torch

from novags.methods.nova.denoiser import Denoiser, donut_blur
from novags.methods.nova.denoiser_config import BlindSpotConfig, DenoiserConfig, ResUNetConfig

TINY = ResUNetConfig(widths=(8, 8), bottleneck=8, normalization="none")


def scene(size: int = 32, count: int = 3) -> torch.Tensor:
    """Smooth images [C, H, W, 3] in 0.2..0.8."""
    t = torch.linspace(0, 3, size)
    waves = [torch.sin(t[:, None] * (1 + i) + c) * torch.cos(t * (1 + c)) for i in range(count) for c in range(3)]
    return 0.5 + 0.3 * torch.stack(waves).reshape(count, 3, size, size).movedim(1, -1)


def noisy_scene(sigma: float = 0.1) -> tuple[torch.Tensor, torch.Tensor]:
    clean = scene()
    return clean, (clean + sigma * torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))).clamp(0, 1)


def config(**changes) -> DenoiserConfig:
    fields = {"network": TINY, "warmup_steps": 60, "denoise_every": None, "batch": 2, "crop": 24, "learning_rate": 3e-3}
    return DenoiserConfig(**{**fields, **changes})


def trained(noisy: torch.Tensor, settings: DenoiserConfig, steps: int) -> Denoiser:
    denoiser = Denoiser(noisy, settings, total_steps=steps, seed=1)
    for _ in range(steps):
        denoiser.train_step()
    return denoiser


def test_training_on_noisy_images_alone_brings_them_closer_to_the_clean_ones():
    clean, noisy = noisy_scene()
    before = (noisy - clean).square().mean()
    plain = trained(noisy, config(), 100).denoise_all()
    residual = trained(noisy, config(residual_blur=1.0), 40).denoise_all()
    assert (plain - clean).square().mean() < 0.6 * before
    assert (residual - clean).square().mean() < 0.3 * before


def test_defaults_are_the_papers():
    default = DenoiserConfig()
    assert default.network == ResUNetConfig()
    assert default.blind_spots == BlindSpotConfig()
    assert (default.residual_blur, default.noisy_share, default.augment, default.decay) == (
        None,
        0.0,
        False,
        "constant",
    )
    assert default.learning_rate == 1e-3


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.5])
def test_the_donut_blur_keeps_constants_and_ignores_the_pixel_itself(sigma):
    torch.testing.assert_close(donut_blur(torch.full((1, 3, 9, 11), 0.3), sigma), torch.full((1, 3, 9, 11), 0.3))
    image = torch.zeros(1, 1, 21, 21)
    image[..., 10, 10] = 1
    blurred = donut_blur(image, sigma)[0, 0]
    assert blurred[10, 10] == 0
    ratio = blurred[10, 12] / blurred[10, 11]
    assert float(ratio) == pytest.approx(math.exp(-1.5 / sigma**2), rel=1e-4)


def test_a_residual_network_starts_at_the_blur():
    _, noisy = noisy_scene()
    denoiser = Denoiser(noisy, config(residual_blur=1.2), total_steps=1, seed=0)
    expected = donut_blur(noisy.movedim(-1, 1), 1.2).movedim(1, -1).clamp(0, 1)
    torch.testing.assert_close(denoiser.denoise_all(), expected)


def test_noisy_share_mixes_the_noisy_image_in():
    _, noisy = noisy_scene()
    without = trained(noisy, config(), 3).denoise_all()
    mixed = trained(noisy, config(noisy_share=0.25), 3).denoise_all()
    torch.testing.assert_close(mixed, 0.75 * without + 0.25 * noisy)


def test_same_seed_same_network_and_the_global_stream_is_left_alone():
    _, noisy = noisy_scene()
    torch.manual_seed(5)
    first = trained(noisy, config(augment=True), 3)
    drawn = torch.rand(1)
    second = trained(noisy, config(augment=True), 3)
    assert torch.equal(first.denoise_all(), second.denoise_all())
    torch.manual_seed(5)
    assert torch.equal(torch.rand(1), drawn)


def test_state_continues_bit_for_bit():
    _, noisy = noisy_scene()
    whole = trained(noisy, config(decay="cosine"), 8)
    half = Denoiser(noisy, config(decay="cosine"), total_steps=8, seed=1)
    for _ in range(4):
        half.train_step()
    resumed = Denoiser(noisy, config(decay="cosine"), total_steps=8, seed=99)
    resumed.restore({name: value.clone() for name, value in half.state().items()})
    assert resumed.step == 4
    for _ in range(4):
        resumed.train_step()
    assert torch.equal(whole.denoise_all(), resumed.denoise_all())


def test_a_state_of_another_network_is_refused():
    _, noisy = noisy_scene()
    state = trained(noisy, config(), 1).state()
    wider = config(network=ResUNetConfig(widths=(8, 8), bottleneck=16, normalization="none"))
    with pytest.raises(ValueError, match="another shape"):
        Denoiser(noisy, wider, total_steps=1, seed=0).restore(state)


def test_cosine_decay_ends_at_zero_and_constant_does_not():
    _, noisy = noisy_scene()
    rates = {}
    for decay in ("cosine", "constant"):
        denoiser = trained(noisy, config(decay=decay), 10)
        rates[decay] = denoiser.optimizer.param_groups[0]["lr"]
    assert rates["constant"] == 3e-3
    assert rates["cosine"] == pytest.approx(3e-3 * 0.5 * (1 + math.cos(0.9 * math.pi)))


def test_gradients_left_in_the_network_join_the_next_step():
    _, noisy = noisy_scene()
    alone, pushed = (Denoiser(noisy, config(), total_steps=2, seed=0) for _ in range(2))
    pushed.denoise(0).sum().backward()
    alone.train_step()
    pushed.train_step()
    assert not torch.equal(alone.denoise_all(), pushed.denoise_all())


@pytest.mark.parametrize(("every", "iterations", "steps"), [(None, 1000, 60), (1, 1000, 1060), (4, 10, 63)])
def test_total_steps_count_warm_up_and_cadence(every, iterations, steps):
    assert config(denoise_every=every).total_steps(iterations) == steps


def test_whole_views_are_used_without_a_crop_and_small_views_shrink_it():
    _, noisy = noisy_scene()
    assert Denoiser(noisy, config(crop=None, batch=1), total_steps=1, seed=0)._draw_batch().shape == (1, 3, 32, 32)
    assert Denoiser(noisy, config(crop=64), total_steps=1, seed=0)._draw_batch().shape == (2, 3, 32, 32)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"warmup_steps": -1}, "warmup_steps must be >= 0, got -1"),
        ({"denoise_every": 0}, "denoise_every must be >= 1 or None, got 0"),
        ({"batch": 0}, "need batch >= 1 and crop >= 2 px, got 0 and None"),
        ({"crop": 1}, "need batch >= 1 and crop >= 2 px, got 1 and 1"),
        ({"learning_rate": 0.0}, "learning_rate must be > 0, got 0.0"),
        ({"residual_blur": 0.0}, "residual_blur must be > 0 px or None, got 0.0"),
        ({"noisy_share": 1.0}, r"noisy_share must lie in \[0, 1\), got 1.0"),
    ],
)
def test_impossible_configurations_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        DenoiserConfig(**wrong)


def test_images_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"\[C, H, W, 3\]"):
        Denoiser(torch.zeros(8, 8, 3), config(), total_steps=1, seed=0)


def test_blinding_one_channel_lets_the_others_tell_a_texture_that_no_neighbour_knows():
    generator = torch.Generator().manual_seed(3)
    clean = (0.5 + 0.15 * torch.randn(3, 32, 32, 1, generator=generator)).expand(-1, -1, -1, 3)
    noisy = clean + 0.1 * torch.randn(clean.shape, generator=generator)
    error = {}
    for per_channel in (False, True):
        spots = BlindSpotConfig(mask_fraction=0.1, laplacian_share=0.0, per_channel=per_channel)
        denoised = trained(noisy, config(blind_spots=spots), 150).denoise_all()
        error[per_channel] = float((denoised - clean).square().mean())
    # all three blinded: only the mean is left to say, 0.15² off; two channels' mean: 0.1² / 2
    assert error[False] > 0.7 * 0.15**2
    assert error[True] < 0.8 * 0.1**2


@pytest.mark.parametrize(
    ("crop", "many", "in_steps", "in_views"),
    [(None, 32 * 32, True, True), (24, 32 * 32, False, True), (None, 32 * 32 + 1, False, False)],
)
def test_the_maps_of_large_pictures_alone_are_returned_as_they_are_freed(monkeypatch, crop, many, in_steps, in_views):
    """In a step until the last gradient is made; of crops it is their own size that counts."""
    entered = []

    @contextmanager
    def sparing(wanted):
        entered.append(wanted)
        yield
        entered.append(None)

    monkeypatch.setattr("novags.methods.nova.denoiser.sparing", sparing)
    monkeypatch.setattr("novags.methods.nova.denoiser.MANY", many)
    denoiser = Denoiser(scene(), config(crop=crop), total_steps=2, seed=0)
    seen = []
    first = next(iter(denoiser.network.parameters()))
    first.register_hook(lambda gradient: seen.append(entered[-1]))
    denoiser.train_step()
    assert seen == [in_steps]
    entered.clear()
    denoiser.denoise(0)
    assert entered == [in_views, None]
