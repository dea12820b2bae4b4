"""SCI against its layers and losses written out in numpy, and what it does to dark pictures."""

import numpy as np
import pytest
import torch

from novags.methods.enhancers.files.weights import read_weights
from novags.methods.enhancers.networks import sci as part
from novags.methods.enhancers.networks.rehearsal import learned
from novags.methods.enhancers.networks.rows.sci import SciConfig
from novags.methods.enhancers.networks.sci import SCI, Calibrator, Illumination, Sci


def network(seed: int = 0) -> Sci:
    made = Sci().double().eval()
    generator = torch.Generator().manual_seed(seed)
    for name, value in made.state_dict().items():
        if value.is_floating_point():
            level = 1.0 if "running_var" in name else 0.0
            value.copy_(level + 0.3 * torch.rand(value.shape, generator=generator, dtype=torch.float64))
    return made


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 0.4, (3, 6, 7))


def layers(made: torch.nn.Module, x: np.ndarray, conv, blocks: int) -> np.ndarray:
    """Either network, its blocks of the same weights."""

    def through(sequence, seen: np.ndarray) -> np.ndarray:
        for layer in sequence:
            if isinstance(layer, torch.nn.Conv2d):
                seen = conv(seen, layer.weight.detach().numpy(), layer.bias.detach().numpy(), 1)
            elif isinstance(layer, torch.nn.BatchNorm2d):
                own = layer.running_mean, layer.running_var, layer.weight, layer.bias
                mean, var, gain, shift = (v.detach().numpy()[:, None, None] for v in own)
                seen = (seen - mean) / np.sqrt(var + 1e-5) * gain + shift
            elif isinstance(layer, torch.nn.Sigmoid):
                seen = 1 / (1 + np.exp(-seen))
            else:
                seen = np.maximum(seen, 0)
        return seen

    seen = through(made.in_conv, x)
    for _ in range(blocks):
        seen = seen + through(made.conv if blocks == 1 else made.convs, seen)
    return through(made.out_conv, seen)


def test_a_picture_is_divided_by_its_estimated_illumination(conv_by_hand):
    made, x = network(), picture()
    light = np.clip(layers(made.enhance, x, conv_by_hand, 1) + x, 1e-4, 1)
    np.testing.assert_allclose(made(torch.from_numpy(x)[None])[0].detach(), np.clip(x / light, 0, 1), atol=1e-12)


def test_each_stage_starts_from_what_the_calibrator_adds(conv_by_hand):
    made, y = network(), picture()
    s, found = np.zeros_like(y), made.stages(torch.from_numpy(y)[None])
    assert len(found) == 3
    for added, x, light in found:
        np.testing.assert_allclose(added[0].detach(), s, atol=1e-11)
        np.testing.assert_allclose(x[0].detach(), y + s, atol=1e-11)
        wanted = np.clip(layers(made.enhance, y + s, conv_by_hand, 1) + y + s, 1e-4, 1)
        np.testing.assert_allclose(light[0].detach(), wanted, atol=1e-11)
        r = np.clip(y / wanted, 0, 1)
        s = r - layers(made.calibrate, r, conv_by_hand, 3)


def test_smoothness_sums_24_neighbours_weighted_by_the_difference_of_colours():
    rng = np.random.default_rng(3)
    x, light = 6 * rng.uniform(0, 1, (2, 3, 5, 6)), rng.uniform(0, 1, (2, 3, 5, 6))
    matrix = np.array([[0.257, 0.504, 0.098], [-0.148, -0.291, 0.439], [0.439, -0.368, -0.071]])
    colors = np.einsum("cd,bdhw->bchw", matrix, x)  # an offset has no difference
    total = 0.0
    for v in range(-2, 3):
        for u in range(-2, 3):
            terms = []
            for b, i, j in np.ndindex(2, 5, 6):
                if (v, u) != (0, 0) and 0 <= i + v < 5 and 0 <= j + u < 6:
                    apart = colors[b, :, i, j] - colors[b, :, i + v, j + u]
                    weight = np.exp(-(apart**2).sum() / 200)
                    terms.append(weight * np.abs(light[b, :, i, j] - light[b, :, i + v, j + u]).sum())
            total += np.mean(terms) if terms else 0.0
    found = float(part.smoothness(*map(torch.from_numpy, (x, light))))
    assert found == pytest.approx(total, rel=1e-12)
    assert float(part.smoothness(torch.from_numpy(x[:, :, :1, :2]), torch.from_numpy(light[:, :, :1, :2]))) > 0


def test_the_loss_is_fidelity_and_smoothness_of_three_stages_and_the_condition_where_asked_for():
    made, y = network(), torch.from_numpy(picture())[None]
    stages = [[v.detach() for v in stage] for stage in made.stages(y)]
    wanted = sum(1.5 * float(((i - x) ** 2).mean()) + float(part.smoothness(x, i)) for _, x, i in stages)
    assert float(part.loss(made, y, SciConfig()).detach()) == pytest.approx(wanted)
    H = made.enhance.added
    apart = sum(float(((H(y + s) - H(y) - H(s)) ** 2).mean().detach()) for s, _, _ in stages[1:])
    assert apart > 1e-3
    assert float(part.loss(made, y, SciConfig(additivity=2.0)).detach()) == pytest.approx(wanted + 2 * apart)


def test_a_training_brightens_until_the_illumination_follows_the_picture():
    """Smooth light and fidelity: with time i approaches x, and x / i approaches 1."""
    dark = torch.full((2, 12, 12, 3), 0.15)
    config = SciConfig(steps=30, rate=4e-2, crop=6, batch=1)
    made, _ = learned(SCI, config, dark, 0)
    before, _ = learned(SCI, SciConfig(steps=0), dark, 0)
    levels = [float(SCI.picture(each, dark[0], config)[0].mean()) for each in (before, made)]
    assert 1.4 * levels[0] < levels[1] <= 1


def test_it_learns_at_the_published_rates():
    (group,) = SCI.rehearsal.optimizer(Sci(), SciConfig()).param_groups
    assert (group["lr"], group["weight_decay"], group["betas"]) == (3e-4, 3e-4, (0.9, 0.999))
    assert SCI.rehearsal.clip == 5.0


def test_with_the_condition_of_sci_plus_the_block_becomes_more_additive():
    dark = 0.3 * torch.rand(2, 12, 12, 3, generator=torch.Generator().manual_seed(0))
    y = dark.movedim(-1, 1)

    def apart(additivity: float) -> float:
        made, _ = learned(SCI, SciConfig(steps=60, rate=2e-2, crop=8, batch=2, additivity=additivity), dark, 0)
        H, (_, (s, _, _), _) = made.enhance.added, made.stages(y)
        return float((H(y + s) - H(y) - H(s)).square().mean())

    assert apart(10.0) < 0.7 * apart(0.0)


@pytest.mark.parametrize("given", [False, True])
def test_pictures_do_not_change_the_network_that_enhances_them(tmp_path, given):
    """Rationale: with the batch's own statistics a picture would be normalised by itself, and move the network's."""
    made, _ = learned(SCI, SciConfig(steps=2, crop=8), 0.3 * torch.rand(1, 12, 12, 3), 0)
    config = SciConfig()
    if given:
        config = SciConfig(weights=(tmp_path / "sci.pt",))
        torch.save(made.state_dict(), tmp_path / "sci.pt")
        made = SCI.load(config)
    before = {name: value.clone() for name, value in made.state_dict().items()}
    SCI.picture(made, torch.rand(9, 8, 3), config)
    assert all(torch.equal(value, before[name]) for name, value in made.state_dict().items())
    assert not any(value.requires_grad for value in made.parameters())


@pytest.mark.parametrize("name", ["easy", "medium", "difficult"])
def test_official_files_have_these_tensors_and_make_dark_photographs_bright(official, dark_fox, plausible, name):
    path = official(f"sci_{name}.pt")
    own = Sci().state_dict()
    assert {n: v.shape for n, v in read_weights((path,)).items()} == {n: v.shape for n, v in own.items()}
    for dark, bright in dark_fox:
        plausible(dark, SCI.enhance(torch.from_numpy(dark), SciConfig(weights=(path,)), None, None)[0].numpy(), bright)


def test_every_block_adds_to_what_the_ones_before_it_made():
    torch.manual_seed(3)
    network = Illumination(width=4, blocks=3).eval()
    picture = torch.rand(1, 3, 6, 5)
    seen = network.in_conv(picture)
    for _ in range(3):
        seen = seen + network.conv(seen)
    torch.testing.assert_close(network.added(picture), network.out_conv(seen))


def test_the_calibrator_goes_through_its_block_three_times() -> None:
    torch.manual_seed(4)
    network = Calibrator(width=4).eval()
    picture = torch.rand(1, 3, 6, 5)
    seen = network.in_conv(picture)
    for _ in range(3):
        seen = seen + network.convs(seen)
    torch.testing.assert_close(network(picture), picture - network.out_conv(seen))


def test_each_block_of_the_illumination_is_added() -> None:
    """Rationale: the published illumination has one block, and would hide that only the first is asked."""
    lone, twice = Illumination(blocks=1).double().eval(), Illumination(blocks=2).double().eval()
    one = network().enhance.state_dict()
    lone.load_state_dict(one)
    twice.load_state_dict(one | {name.replace("blocks.0", "blocks.1"): value for name, value in one.items()})
    x = torch.from_numpy(picture())[None]
    with torch.no_grad():
        once = lone.in_conv(x) + lone.conv(lone.in_conv(x))
        torch.testing.assert_close(lone.added(x), lone.out_conv(once))
        torch.testing.assert_close(twice.added(x), lone.out_conv(once + lone.conv(once)))
        assert float((lone.added(x) - twice.added(x)).abs().max()) > 1e-4
