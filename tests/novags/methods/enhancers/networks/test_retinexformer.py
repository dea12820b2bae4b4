"""Retinexformer against its layers written out in numpy, and its size."""

import numpy as np
import torch
from scipy.special import erf

from novags.methods.enhancers.networks.retinexformer import (
    Attention,
    Blocks,
    Estimator,
    FeedForward,
    Normed,
    Retinexformer,
)


def randomised(module: torch.nn.Module, scale: float = 0.3) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(0)
    module = module.double()
    for value in module.parameters():
        value.data = scale * torch.randn(value.shape, generator=generator, dtype=torch.float64)
    return module


def weight(layer: torch.nn.Module) -> np.ndarray:
    return layer.weight.detach().numpy()


def gelu(x: np.ndarray) -> np.ndarray:
    return x * (1 + erf(x / np.sqrt(2))) / 2


def grouped(x: np.ndarray, kernel: np.ndarray, pad: int, groups: int, conv) -> np.ndarray:
    """Channels in groups, each with convolutions of its own."""
    parts = zip(np.split(x, groups), np.split(kernel, groups), strict=True)
    return np.concatenate([conv(part, own, None, pad) for part, own in parts])


def test_attention_compares_channels_over_pixels_and_is_guided_by_the_light(conv_by_hand):
    made = randomised(Attention(8, 2))
    rng = np.random.default_rng(0)
    x, light = rng.normal(size=(4, 5, 8)), rng.normal(size=(4, 5, 8))
    pixels, lights = x.reshape(20, 8), light.reshape(20, 8)
    q, k, v = (pixels @ weight(layer).T for layer in (made.to_q, made.to_k, made.to_v))
    mixed = np.zeros((20, 8))
    for head in range(2):
        own = slice(4 * head, 4 * head + 4)
        scores = np.zeros((4, 4))
        for a, b in np.ndindex(4, 4):
            of_k, of_q = k[:, own][:, a], q[:, own][:, b]
            scores[a, b] = of_k @ of_q / np.linalg.norm(of_k) / np.linalg.norm(of_q)
        scores = np.exp(scores * float(made.rescale.detach()[head]))
        scores /= scores.sum(1, keepdims=True)
        mixed[:, own] = (v * lights)[:, own] @ scores.T
    wanted = mixed @ weight(made.proj).T + made.proj.bias.detach().numpy()
    placed = v.reshape(4, 5, 8).transpose(2, 0, 1)
    placed = gelu(grouped(placed, weight(made.pos_emb[0]), 1, 8, conv_by_hand))
    placed = grouped(placed, weight(made.pos_emb[2]), 1, 8, conv_by_hand)
    found = made(torch.from_numpy(x)[None], torch.from_numpy(light)[None])[0].detach().numpy()
    np.testing.assert_allclose(found, wanted.reshape(4, 5, 8) + placed.transpose(1, 2, 0), atol=1e-11)


def test_the_feed_forward_network_is_normed_over_channels(conv_by_hand):
    made = randomised(Normed(4))
    x = np.random.default_rng(1).normal(size=(3, 4, 4))
    mean, var = x.mean(-1, keepdims=True), x.var(-1, keepdims=True)
    gain, shift = (p.detach().numpy() for p in (made.norm.weight, made.norm.bias))
    seen = ((x - mean) / np.sqrt(var + 1e-5) * gain + shift).transpose(2, 0, 1)
    assert isinstance(made.fn, FeedForward)
    seen = gelu(conv_by_hand(seen, weight(made.fn.net[0]), None, 0))
    seen = gelu(grouped(seen, weight(made.fn.net[2]), 1, 16, conv_by_hand))
    seen = conv_by_hand(seen, weight(made.fn.net[4]), None, 0)
    np.testing.assert_allclose(made(torch.from_numpy(x)[None])[0].detach(), seen.transpose(1, 2, 0), atol=1e-11)


def test_blocks_add_attention_then_the_feed_forward_network():
    made = randomised(Blocks(4, 1, 2))
    x, light = torch.randn(2, 1, 4, 3, 3, dtype=torch.float64).unbind(0)
    wanted, lights = x.movedim(1, -1), light.movedim(1, -1)
    for attend, feed in made.blocks:
        wanted = wanted + attend(wanted, lights)
        wanted = wanted + feed(wanted)
    torch.testing.assert_close(made(x, light), wanted.movedim(-1, 1))


def test_the_estimator_sees_the_channels_and_their_mean(conv_by_hand):
    made = randomised(Estimator(8))
    x = np.random.default_rng(2).uniform(0, 1, (3, 4, 5))
    seen = conv_by_hand(np.concatenate([x, x.mean(0, keepdims=True)]), weight(made.conv1),
                        made.conv1.bias.detach().numpy(), 0)  # fmt: skip
    features = grouped(seen, weight(made.depth_conv), 2, 4, conv_by_hand)
    features = features + made.depth_conv.bias.detach().numpy()[:, None, None]
    up = conv_by_hand(features, weight(made.conv2), made.conv2.bias.detach().numpy(), 0)
    for found, wanted in zip(made(torch.from_numpy(x)[None]), (features, up), strict=True):
        np.testing.assert_allclose(found[0].detach(), wanted, atol=1e-11)


def test_the_whole_is_a_u_net_on_the_lit_up_picture(conv_by_hand):
    """Levels by the parts above; halving, doubling and fusing by hand."""
    made = randomised(Retinexformer(4, (1, 1, 1)), 0.2)
    x = np.random.default_rng(3).uniform(0, 0.3, (3, 4, 8))
    stage, net = made.body[0], made.body[0].denoiser

    def t(a: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(a)[None]

    def n(a: torch.Tensor) -> np.ndarray:
        return a[0].detach().numpy()

    light, up = map(n, stage.estimator(t(x)))
    lit = x * up + x
    seen, levels = conv_by_hand(lit, weight(net.embedding), None, 1), []
    for attend, halve, halve_light in net.encoder_layers:
        seen = n(attend(t(seen), t(light)))
        levels.append((seen, light))
        seen = conv_by_hand(seen, weight(halve), None, 1, 2)
        light = conv_by_hand(light, weight(halve_light), None, 1, 2)
    seen = n(net.bottleneck(t(seen), t(light)))
    for (double, fuse, attend), (finer, light) in zip(net.decoder_layers, levels[::-1], strict=True):
        kernel, larger = weight(double), np.zeros((len(seen) // 2, 2 * seen.shape[1], 2 * seen.shape[2]))
        for c, i, j in np.ndindex(seen.shape):
            larger[:, 2 * i : 2 * i + 2, 2 * j : 2 * j + 2] += seen[c, i, j] * kernel[c]
        larger += double.bias.detach().numpy()[:, None, None]
        seen = conv_by_hand(np.concatenate([larger, finer]), weight(fuse), None, 0)
        seen = n(attend(t(seen), t(light)))
    wanted = conv_by_hand(seen, weight(net.mapping), None, 1) + lit
    np.testing.assert_allclose(n(made(t(x))), wanted, atol=1e-10)


def test_it_has_the_published_size_and_takes_pictures_of_any():
    made = Retinexformer()
    assert sum(value.numel() for value in made.parameters()) == 1_605_701  # "1.61 M"
    small = randomised(Retinexformer(4, (1, 1, 1)))
    x = torch.rand(1, 3, 3, 5, dtype=torch.float64)
    whole = torch.cat([x, x[:, :, -1:]], 2)
    whole = torch.cat([whole, whole[..., -1:].expand(-1, -1, -1, 3)], 3)
    assert torch.equal(small(x), small(whole)[:, :, :3, :5])
