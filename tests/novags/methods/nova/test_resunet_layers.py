"""The network against one written out from the supplement, section B.3, with loops over pixels and no torch layer."""

import numpy as np
import pytest
import torch

from novags.methods.nova.denoiser_config import ResUNetConfig
from novags.methods.nova.layers.normalise import normalised
from novags.methods.nova.resunet import ResUNet, SqueezeExcite

Weights = dict[str, np.ndarray]


def convolve(x: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """x [D, H, W], 3 x 3 after one reflected pixel all round."""
    padded = np.pad(x, ((0, 0), (1, 1), (1, 1)), mode="reflect")
    out = np.empty((len(weight), *x.shape[1:]))
    for row, column in np.ndindex(x.shape[1:]):
        window = padded[:, row : row + 3, column : column + 3]
        out[:, row, column] = (weight * window).sum((1, 2, 3)) + bias
    return out


def one_by_one(x: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    return np.einsum("oi,ihw->ohw", weight[:, :, 0, 0], x) + bias[:, None, None]


def normalise(x: np.ndarray, kind: str) -> np.ndarray:
    if kind == "none":
        return x
    mean, variance = x.mean((1, 2), keepdims=True), x.var((1, 2), keepdims=True)
    return (x - mean) / np.sqrt(variance + 1e-5)


def leaky(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, 0.2 * x)


def halve(x: np.ndarray) -> np.ndarray:
    d, h, w = x.shape
    return x.reshape(d, h // 2, 2, w // 2, 2).max((2, 4))


def double(x: np.ndarray) -> np.ndarray:
    """Bilinear: the centre of new pixel i lies at (i + 0.5) / 2 - 0.5 of the old grid; the border repeats."""
    for axis in (1, 2):
        at = np.clip((np.arange(2 * x.shape[axis]) + 0.5) / 2 - 0.5, 0, x.shape[axis] - 1)
        low = np.minimum(at.astype(int), x.shape[axis] - 1)
        high = np.minimum(low + 1, x.shape[axis] - 1)
        share = np.expand_dims(at - low, tuple({0, 1, 2} - {axis}))
        x = np.take(x, low, axis) * (1 - share) + np.take(x, high, axis) * share
    return x


def gate(x: np.ndarray, w: Weights, name: str) -> np.ndarray:
    hidden = np.maximum(w[f"{name}.1.weight"][:, :, 0, 0] @ x.mean((1, 2)) + w[f"{name}.1.bias"], 0)
    logits = w[f"{name}.3.weight"][:, :, 0, 0] @ hidden + w[f"{name}.3.bias"]
    return x / (1 + np.exp(-logits))[:, None, None]


def level(x: np.ndarray, w: Weights, name: str, kind: str) -> np.ndarray:
    x = leaky(normalise(convolve(x, w[f"{name}.enter.0.weight"], w[f"{name}.enter.0.bias"]), kind))
    if f"{name}.second.0.weight" in w:  # of a plain U-Net
        return leaky(normalise(convolve(x, w[f"{name}.second.0.weight"], w[f"{name}.second.0.bias"]), kind))
    y = leaky(normalise(convolve(x, w[f"{name}.residual.0.weight"], w[f"{name}.residual.0.bias"]), kind))
    y = normalise(convolve(y, w[f"{name}.residual.3.weight"], w[f"{name}.residual.3.bias"]), kind)
    return leaky(x + gate(y, w, f"{name}.residual.5.gate"))


def by_hand(image: np.ndarray, w: Weights, levels: int, kind: str) -> np.ndarray:
    """image [3, H, W] of a size that needs no padding."""
    skips, x = [], image
    for i in range(levels):
        x = level(x, w, f"encoder.{i}", kind)
        skips.append(x)
        x = halve(x)
    x = level(x, w, "bottleneck", kind)
    for i in reversed(range(levels)):
        x = one_by_one(double(x), w[f"reduce.{i}.weight"], w[f"reduce.{i}.bias"])
        x = level(np.concatenate([x, skips[i]]), w, f"decoder.{i}", kind)
    return one_by_one(x, w["head.weight"], w["head.bias"])


def network_and_weights(kind: str, blocks: str = "attention-residual", channels: int = 3) -> tuple[ResUNet, Weights]:
    config = ResUNetConfig(widths=(4, 6), bottleneck=8, se_reduction=2, normalization=kind, blocks=blocks)
    network = ResUNet(config, channels).double()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator, dtype=torch.float64) * 0.3)
    weights = {name: value.numpy() for name, value in network.state_dict().items()}
    return network, {name: np.moveaxis(w, -1, 1) if w.ndim == 4 else w for name, w in weights.items()}


def image(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 1, (3, height, width))


@pytest.mark.parametrize("kind", ["instance", "none"])
def test_the_network_equals_the_one_written_out(kind):
    network, weights = network_and_weights(kind)
    picture = image(12, 16)
    with torch.no_grad():
        found = network(torch.from_numpy(picture)[None])[0].numpy()
    np.testing.assert_allclose(found, by_hand(picture, weights, 2, kind), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("channels", [3, 4])
def test_a_plain_network_has_two_convolutions_a_level_and_neither_residuals_nor_gates(channels):
    network, weights = network_and_weights("instance", "plain", channels)
    assert not any("residual" in name or "gate" in name for name in weights)
    assert sum("enter" in name or "second" in name for name in weights) == 2 * 2 * 5
    picture = np.random.default_rng(2).uniform(0, 1, (channels, 8, 12))
    with torch.no_grad():
        found = network(torch.from_numpy(picture)[None])[0].numpy()
    np.testing.assert_allclose(found, by_hand(picture, weights, 2, "instance"), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("size", "padded", "mode"),
    [((13, 10), (16, 12), "reflect"), ((8, 9), (8, 12), "reflect"), ((5, 9), (8, 12), "reflect"),
     ((3, 8), (8, 8), "edge"), ((4, 8), (8, 8), "edge"), ((8, 1), (8, 8), "edge")],
)  # fmt: skip
def test_other_sizes_are_padded_below_and_to_the_right_and_cropped(size, padded, mode):
    network, weights = network_and_weights("none")
    picture = image(*size)
    wide = np.pad(picture, ((0, 0), (0, padded[0] - size[0]), (0, padded[1] - size[1])), mode=mode)
    with torch.no_grad():
        found = network(torch.from_numpy(picture)[None])[0].numpy()
    expected = by_hand(wide, weights, 2, "none")[:, : size[0], : size[1]]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_images_of_a_batch_do_not_meet():
    network, _ = network_and_weights("instance")
    batch = torch.from_numpy(np.stack([image(8, 8), 0.3 * image(8, 8)[::-1]]))
    with torch.no_grad():
        torch.testing.assert_close(network(batch), torch.cat([network(batch[:1]), network(batch[1:])]))


def test_a_map_that_is_constant_up_to_rounding_is_zero_beside_one_that_varies():
    x = torch.linspace(-3, 3, 64).reshape(1, 1, 8, 8).repeat(3, 2, 1, 1)
    x[2] = -x[2]  # its largest value comes first
    x[1:, 1] = torch.tensor([0.1, -40.0])[:, None, None] * (1 + 1e-7 * x[0, 0])
    y = normalised(x, 0.2)
    assert y.flatten(2).any(2).tolist() == [[True, True], [True, False], [True, False]]


def test_the_papers_network_has_the_parameters_that_its_widths_call_for():
    def conv(a: int, b: int, edge: int) -> int:
        return a * b * edge**2 + b

    def parameters_of_level(a: int, b: int) -> int:
        return conv(a, b, 3) + 2 * conv(b, b, 3) + conv(b, b // 16, 1) + conv(b // 16, b, 1)

    widths, bottleneck = [32, 64, 128, 256], 512
    down = sum(parameters_of_level(a, b) for a, b in zip([3, *widths], [*widths, bottleneck], strict=True))
    up = sum(parameters_of_level(2 * a, a) for a in widths)
    reduce = sum(conv(b, a, 1) for a, b in zip(widths, [*widths[1:], bottleneck], strict=True))
    assert sum(p.numel() for p in ResUNet().parameters()) == down + up + reduce + conv(32, 3, 1)


def test_the_default_configuration_is_the_papers():
    assert ResUNet().config == ResUNetConfig(
        widths=(32, 64, 128, 256),
        bottleneck=512,
        blocks="attention-residual",
        se_reduction=16,
        normalization="instance",
        precision="float32",
    )


@pytest.mark.parametrize(("channels", "reduction", "hidden"), [(64, 16, 4), (8, 16, 1), (6, 2, 3)])
def test_the_gate_reduces_by_the_ratio_to_at_least_one_channel(channels, reduction, hidden):
    assert SqueezeExcite(channels, reduction).gate[1].out_channels == hidden


def test_only_the_coarse_network_rounds_to_bfloat16():
    picture = torch.from_numpy(image(8, 8))[None].float()
    outputs = {}
    for precision in ("float32", "bfloat16"):
        torch.manual_seed(0)
        outputs[precision] = ResUNet(ResUNetConfig(widths=(4, 6), bottleneck=8, precision=precision))(picture)
    coarse = outputs["bfloat16"]
    assert torch.equal(coarse, coarse.bfloat16().float())
    assert not torch.equal(outputs["float32"], outputs["float32"].bfloat16().float())
