"""The losses of the methods with a field, against slow versions written from their equations."""

import math
from typing import Any

import numpy as np
import pytest
import torch

from novags.fields.box import Box
from novags.fields.march import Rays, Samples
from novags.fields.training.batch import Batch
from novags.fields.training.config import FieldFitConfig
from novags.methods.light import MeasuredLight, raw_loss
from novags.methods.nerf import aleth, i2, llnerf, raw
from novags.methods.nerf.losses import differences, robust
from novags.methods.nerf.rows.aleth_nerf import AlethConfig
from novags.methods.nerf.rows.i2_nerf import I2Config
from novags.methods.nerf.rows.ll_nerf import LlnerfConfig
from novags.methods.nerf.shading import brightened, light_of, product, retinex
from novags.splats.training.losses import ssim

PATCH, RAYS, N = 2, 16, 5
GREY = np.array([0.299, 0.587, 0.114])


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def some_batch(outputs: int) -> Batch:
    r = rng()
    raw, widths = torch.from_numpy(r.normal(size=(RAYS, N, outputs))), torch.from_numpy(r.random((RAYS, N)))
    weights = torch.from_numpy(r.dirichlet(np.ones(N + 1), RAYS)[:, :N])
    rays = Rays(torch.zeros(RAYS, 3), torch.ones(RAYS, 3), torch.ones(RAYS))
    samples = Samples(torch.cumsum(widths, 1), widths, np.zeros((RAYS * N, 3), np.float32))
    index = torch.zeros(RAYS, dtype=torch.int64)
    return Batch(3, index, index, index, PATCH, rays, samples, raw, weights)


def sigmoid(x: Any) -> Any:
    return 1 / (1 + np.exp(-x))


def neighbours() -> list[tuple[int, int]]:
    """Pairs of rays that are neighbours in squares of two."""
    pairs = []
    for square in range(RAYS // 4):
        a, b, c, d = (4 * square + i for i in range(4))
        pairs += [(a, b), (c, d), (a, c), (b, d)]
    return pairs


def test_the_robust_loss_is_round_at_nothing_and_straight_beyond() -> None:
    errors = rng().normal(size=(6, 3)) * np.logspace(-5, 0, 6)[:, None]
    expected = sum(0.05 * math.sqrt(e * e + 1e-6) for row in errors for e in row) / 18
    x = torch.from_numpy(errors).requires_grad_()
    loss = robust(x)
    loss.backward()
    assert loss.item() == pytest.approx(expected, rel=1e-12)
    slopes = [[0.05 * e / math.sqrt(e * e + 1e-6) / 18 for e in row] for row in errors]
    np.testing.assert_allclose(x.grad.numpy(), slopes, rtol=1e-10)


def test_raw_loss_divides_by_the_render_and_leaves_out_what_was_not_measured() -> None:
    render, data = rng().random((7, 3)), rng().random((7, 3)) * 1.5
    data[2, 1] = np.nan
    white, total, count = np.array([0.5, 1.0, 0.8]), 0.0, 0
    for y, d in zip(render, data, strict=True):
        for c in range(3):
            if not math.isnan(d[c]):
                total += (min(y[c], white[c]) - d[c]) ** 2 / (y[c] + 0.01) ** 2
                count += 1
    x = torch.from_numpy(render).requires_grad_()
    loss = raw_loss(x, torch.from_numpy(data), 0.01, torch.from_numpy(white))
    assert float(loss.detach()) == pytest.approx(total / count, rel=1e-12)
    loss.backward()
    held = [(2 * (y[0] - d[0]) / (y[0] + 0.01) ** 2 / count) if y[0] < 0.5 else 0.0
            for y, d in zip(render, data, strict=True)]  # fmt: skip
    np.testing.assert_allclose(x.grad[:, 0].numpy(), held, rtol=1e-9)


def test_a_field_of_light_begins_at_the_mean_of_what_was_measured() -> None:
    """A hundredth of the brightest light at least: noise around black has a mean of either sign."""
    light = torch.from_numpy(rng().uniform(0, 1, (2, 30, 40, 3))).float()
    light[..., 0][rng().random((2, 30, 40)) < 0.5] = torch.nan
    noise: Any = None
    for shift, want in ((0.0, float(light.nanmean())), (-0.6, 0.01 * float(np.nanquantile(light[..., 1] - 0.6, 0.99)))):
        data = MeasuredLight(light=light + shift, noise=noise, white=torch.ones(3), matrix=None)
        assert raw.first_unit(data) == pytest.approx(want, rel=1e-3)


def test_the_tone_curve_of_aleth_is_the_inverse_of_the_smooth_step() -> None:
    x = torch.linspace(0.001, 0.999, 50, dtype=torch.float64)
    y = aleth.tone(x)
    np.testing.assert_allclose((3 * y**2 - 2 * y**3).numpy(), x.numpy(), atol=1e-9)


def test_concealed_colours_and_the_loss_of_aleth_are_those_of_the_equations() -> None:
    batch, config = some_batch(5), AlethConfig(fit=FieldFitConfig(patch=PATCH), grey=0.1)
    along, taps = rng().random(N), rng().normal(size=7)
    along[1] = -0.2  # what is trained may go below 0, and then lets nothing through
    dark, lit = aleth.concealed(batch, torch.from_numpy(along), torch.from_numpy(taps), -0.7)
    raw, w = batch.raw.numpy(), batch.weights.numpy()
    slow_dark, slow_lit = np.zeros((RAYS, 3)), np.zeros((RAYS, 3))
    for r in range(RAYS):
        for i in range(N):
            local = sum(taps[k] * raw[r, i + k - 3, 1] for k in range(7) if 0 <= i + k - 3 < N)
            color = sigmoid(raw[r, i, 2:])
            slow_dark[r] += w[r, i] * max(along[i], 0.0) * sigmoid(local - 0.7) * color
            slow_lit[r] += w[r, i] * color
    np.testing.assert_allclose(dark.numpy(), slow_dark, rtol=1e-10)
    np.testing.assert_allclose(lit.numpy(), slow_lit, rtol=1e-10)
    target = rng().random((RAYS, 3)) * 0.2

    def f(x: float) -> float:
        return 0.5 - math.sin(math.asin(1 - 2 * x) / 3)

    photometric = np.mean([(f(a) - f(b)) ** 2 for a, b in zip(slow_dark.flat, target.flat, strict=True)])
    grey = [image @ GREY for image in (slow_lit, target)]
    structure = np.mean([((grey[0][b] - grey[0][a]) - 0.45 * 12 * (grey[1][b] - grey[1][a])) ** 2
                         for a, b in neighbours()])  # fmt: skip
    means = slow_lit.mean(0)
    world = sum((means[a] - means[b]) ** 2 for a, b in ((0, 1), (1, 2), (2, 0)))
    expected = photometric + 1e-3 * (slow_lit.mean() - 0.45) ** 2 + 1e-3 * structure + 0.1 * world
    assert float(aleth.loss_of(dark, lit, torch.from_numpy(target), PATCH, config)) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(("level", "shown"), [(0.002, 0.002), (0.1, 0.1), (0.4, 0.125), (0.0, 2.5e-4)])
def test_the_first_concealing_makes_first_colours_as_dark_as_the_pictures(level: float, shown: float) -> None:
    """Bright pictures begin as published, g = O = 1/2; black ones have a finite logit."""
    first, batch = aleth.first_concealing(torch.full((2, 4, 5, 3), level)), some_batch(5)
    at_first = Batch(**{**vars(batch), "raw": torch.zeros_like(batch.raw)})
    along, taps = torch.full((N,), aleth.FIRST_ALONG, dtype=torch.float64), torch.ones(7, dtype=torch.float64)
    dark, _ = aleth.concealed(at_first, along, taps, first)
    np.testing.assert_allclose(dark, shown * batch.weights.sum(1)[:, None].expand(-1, 3), rtol=1e-6)


def test_the_decomposition_and_the_enhancement_of_llnerf_are_those_of_the_equations() -> None:
    batch, config = some_batch(9), LlnerfConfig(fit=FieldFitConfig(patch=PATCH))
    seen = llnerf.decomposed(batch, -1.5)
    values, w = sigmoid(batch.raw.numpy()), batch.weights.numpy()
    r_, a_, g_, l_ = values[..., 1:4], values[..., 4:5], values[..., 5:8], sigmoid(batch.raw.numpy()[..., 8:9] - 1.5)
    lit = (w[..., None] * r_ * ((l_ + 1e-6) / (a_ + 1e-4)) ** (1 / (g_ + 2.2))).sum(1)
    np.testing.assert_allclose(seen.dark.numpy(), (w[..., None] * r_ * l_).sum(1), rtol=1e-10)
    np.testing.assert_allclose(seen.lit.numpy(), lit, rtol=1e-10)
    level, gamma, light, colour = ((w[..., None] * v).sum(1) for v in (a_, g_, l_, r_))
    smooth = 0.0
    for image in (level, gamma):
        terms = [1.5 * (image[b, c] - image[a, c]) ** 2
                 / ((math.log(light[b, 0] + 1e-4) - math.log(light[a, 0] + 1e-4)) ** 2 + 1e-4)
                 for a, b in neighbours() for c in range(image.shape[1])]  # fmt: skip
        smooth += np.mean(terms)
    paint, roots = colour / colour.max(), []
    for c_e, p in zip(lit, paint, strict=True):
        pairs = sum((c_e[i] - c_e[j]) ** 2 for i, j in ((0, 1), (1, 2), (2, 0))) / 3
        roots.append(math.sqrt(pairs / (np.var(p) + 0.5)))
    exposure = np.mean([(c_e.sum() / 3 - 0.55) ** 2 for c_e in lit])
    expected = 0.1 * exposure + 0.1 * np.mean(roots) + 0.1 * smooth + 0.01 * np.mean(gamma**2)
    assert float(llnerf.enhancement_loss(seen, PATCH, config)) == pytest.approx(expected, rel=1e-8)
    assert float(brightened(torch.tensor(0.2), torch.tensor(0.1), torch.tensor(0.3))) == pytest.approx(
        (0.2 / 0.1001) ** (1 / 2.5), rel=1e-5
    )


def test_colours_learn_nothing_but_a_and_g_from_the_enhancement_of_llnerf_and_grey_rays_have_a_slope() -> None:
    batch, config = some_batch(9), LlnerfConfig(fit=FieldFitConfig(patch=PATCH))
    raw = batch.raw.clone()
    raw[:4, :, 1:4], raw[:4, :, 5:8] = 0.3, 0.1  # four rays are grey
    raw.requires_grad_()
    llnerf.enhancement_loss(llnerf.decomposed(Batch(**{**vars(batch), "raw": raw}), -1.5), PATCH, config).backward()
    assert raw.grad is not None
    assert bool(torch.isfinite(raw.grad).all())
    assert not raw.grad[..., [1, 2, 3, 8]].any()  # R and L
    assert bool((raw.grad[..., 4:8] != 0).all())


@pytest.mark.parametrize("level", [0.002, 0.1, 0.4])
def test_the_first_illumination_makes_first_colours_as_dark_as_the_pictures(level: float) -> None:
    first = llnerf.first_illumination(torch.full((2, 4, 5, 3), level))
    batch = some_batch(9)
    at_first = Batch(**{**vars(batch), "raw": torch.zeros_like(batch.raw)})
    seen = llnerf.decomposed(at_first, first)
    np.testing.assert_allclose(seen.dark, level * batch.weights.sum(1)[:, None].expand(-1, 3), rtol=1e-6)
    shown = product(at_first.raw, batch.weights, {"illumination": first})
    np.testing.assert_allclose(shown, seen.dark, rtol=1e-12)
    np.testing.assert_allclose(retinex(batch.raw, batch.weights, {"illumination": first}),
                               llnerf.decomposed(batch, first).lit, rtol=1e-12)  # fmt: skip
    for blank in (0.0, 1.0):  # black and white pictures have a first illumination too
        assert math.isfinite(llnerf.first_illumination(torch.full((1, 2, 2, 3), blank)))


def test_the_first_medium_makes_first_colours_as_dark_as_the_pictures_halfway_through_the_scene() -> None:
    box = Box(center=(0, 0, 0), half=(2, 1, 1), near=0.5, middle=6, far=50)
    images = torch.full((2, 4, 5, 3), 0.1)
    first = i2.first_absorption(images, box)
    assert 0.5 * math.exp(-first * 3 / 2) == pytest.approx(0.1)  # 3 of 6 world units, in units of half of the box
    batch = some_batch(5)
    at_first = Batch(**{**vars(batch), "raw": torch.zeros_like(batch.raw)})
    assert i2.seen_through(at_first, first)[2].numpy() == pytest.approx(first)
    brightest, black = (i2.first_absorption(torch.full((1, 2, 2, 3), level), box) for level in (1.0, 0.0))
    assert 0 < brightest < first < black < 5


def test_light_through_the_medium_and_the_loss_of_i2_are_those_of_the_equations() -> None:
    batch, config = some_batch(5), I2Config(fit=FieldFitConfig(patch=PATCH))
    dark, lit, medium = i2.seen_through(batch, math.exp(-3))
    raw, w, d = batch.raw.numpy(), batch.weights.numpy(), batch.samples.widths.numpy()
    s, slow = np.exp(raw[..., 1] - 3), np.zeros((RAYS, 3))
    for r in range(RAYS):
        for i in range(N):
            slow[r] += w[r, i] * math.exp(-sum(s[r, j] * d[r, j] for j in range(i + 1))) * sigmoid(raw[r, i, 2:])
    np.testing.assert_allclose(dark.numpy(), slow, rtol=1e-10)
    np.testing.assert_allclose(lit.numpy(), (w[..., None] * sigmoid(raw[..., 2:])).sum(1), rtol=1e-10)
    target, aim = (torch.from_numpy(rng().random((RAYS, 3))) for _ in range(2))
    found = {}
    weights = ("dark", "structure", "bright", "overlap", "variation")
    for name in weights:  # one term at a time
        one = I2Config(**{other: float(other == name) for other in weights}, fit=config.fit)
        found[name] = float(i2.loss_of(dark, lit, medium, batch, target, aim, one))
    assert found["dark"] == pytest.approx(float(raw_loss(dark, target, 1e-3)), rel=1e-9)
    bright = np.mean([(1 - lit.numpy().reshape(-1, 12)[k].max()) ** 2 for k in range(RAYS // 4)])
    assert found["bright"] == pytest.approx(bright, rel=1e-9)
    overlap = np.mean([sum(w[r, i] * (1 - math.exp(-s[r, i] * d[r, i])) for i in range(N)) for r in range(RAYS)])
    assert found["overlap"] == pytest.approx(overlap, rel=1e-9)
    assert found["variation"] == pytest.approx(np.abs(np.diff(s, axis=1)).mean(), rel=1e-9)
    order = np.random.default_rng([RAYS, batch.iteration]).permutation(RAYS)  # one square, of rays in any order
    squares = [image.numpy()[order].reshape(4, 4, 3) for image in (lit, aim)]
    assert found["structure"] == pytest.approx(1 - float(ssim(*map(torch.from_numpy, squares))), rel=1e-9)
    exact = I2Config(dark=0, structure=1, bright=0, overlap=0, variation=0, fit=config.fit)
    assert float(i2.loss_of(dark, lit, medium, batch, target, lit, exact)) == pytest.approx(0, abs=1e-9)


def test_s3im_of_i2_takes_a_square_of_so_many_pixels_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(i2, "LARGEST", 3)
    fit = FieldFitConfig(patch=PATCH)
    batch, config = some_batch(5), I2Config(dark=0, bright=0, overlap=0, variation=0, fit=fit)
    dark, lit, medium = i2.seen_through(batch, math.exp(-3))
    aim = torch.from_numpy(rng().random((RAYS, 3)))
    order = np.random.default_rng([RAYS, batch.iteration]).permutation(RAYS)[:9]
    want = 1 - float(ssim(lit[order].reshape(3, 3, 3), aim[order].reshape(3, 3, 3)))
    assert float(i2.loss_of(dark, lit, medium, batch, dark, aim, config)) == pytest.approx(want, rel=1e-9)


def test_every_iteration_of_i2_compares_other_squares_of_the_same_pixels() -> None:
    first, again, later = (i2._shuffled(16, iteration) for iteration in (3, 3, 4))
    assert first.tolist() == again.tolist() != later.tolist()
    assert sorted(later.tolist()) == list(range(16))


def test_the_mapping_of_i2_moves_the_mean_and_multiplies_the_contrast() -> None:
    image = torch.tensor([[0.1, 0.12, 0.05], [0.2, 0.0, 0.13]])
    found = i2.mapped(image, 0.1, 0.45, 6.0)
    torch.testing.assert_close(found, torch.tensor([[0.45, 0.57, 0.15], [1.0, 0.0, 0.63]]))


def test_light_has_no_upper_end_but_that_of_an_exponential() -> None:
    raw, weights = torch.tensor([[[0.0, 14.0, 20.0, 1e4]]]), torch.tensor([[0.5]])
    want = 0.5 * np.exp([14.0, 15.0, 15.0])
    np.testing.assert_allclose(light_of(raw, weights)[0].numpy(), want, rtol=1e-5)


def test_differences_are_those_to_the_right_and_below() -> None:
    square = torch.tensor([[[1.0, 2.0], [4.0, 8.0]]])
    assert differences(square).tolist() == [1.0, 4.0, 3.0, 6.0]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: AlethConfig(target=1.5), "target must lie in"),
        (lambda: AlethConfig(fit=FieldFitConfig(patch=1)), "fit.patch >= 2"),
        (lambda: LlnerfConfig(mean=0.0), "mean must lie in"),
        (lambda: I2Config(contrast=0.0), "contrast be > 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(make: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()
