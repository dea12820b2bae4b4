"""URetinex-Net against its equations and layers written out in numpy, and the official files."""

import numpy as np
import pytest
import torch

from novags.methods.enhancers.files.weights import read_weights
from novags.methods.enhancers.networks.rows.uretinex import URetinexConfig
from novags.methods.enhancers.networks.uretinex import URETINEX, URetinex, renamed


def network() -> URetinex:
    made = URetinex().double()
    generator = torch.Generator().manual_seed(0)
    for value in made.parameters():
        scale = 1.3 / np.sqrt(value[0].numel()) if value.ndim > 1 else 0.1
        value.data = scale * (0.05 + torch.randn(value.shape, generator=generator, dtype=torch.float64))
    return made


def leaky(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, 0.2 * x)


def by_hand(made: URetinex, I: np.ndarray, ratio: float, conv) -> tuple[list[np.ndarray], np.ndarray]:  # noqa: E741
    values = {name: value.numpy() for name, value in made.state_dict().items()}

    def layer(name: str, x: np.ndarray, pad: int) -> np.ndarray:
        return conv(x, values[f"{name}.weight"], values[f"{name}.bias"], pad)

    x = I
    for i in (0, 2, 4):
        x = leaky(layer(f"model_decom.decom.{i}", x, 1))
    both = np.maximum(layer("model_decom.decom.6", x, 1), 0)
    R, L = both[:3], both[3:]
    Q, rounds = L, []
    for g, weight in ((0.1, 0.5), (0.15, 0.55), (0.2, 0.6)):
        if not rounds:
            P, Q = R, L
        else:
            P = np.stack([(I[c] * Q[0] + g * R[c]) / (Q[0] ** 2 + g) for c in range(3)])
            Q = (sum(I[c] * P[c] for c in range(3)) + weight * L[0]) / (sum(P[c] ** 2 for c in range(3)) + weight)
            Q = Q[None]
        x = np.concatenate([np.maximum(layer("model_R.conv1", P, 1), 0), np.maximum(layer("model_R.conv2", Q, 1), 0)])
        squeezed = np.maximum(values["model_R.se_layer.fc.0.weight"] @ x.mean((1, 2)), 0)
        x = x / (1 + np.exp(-values["model_R.se_layer.fc.2.weight"] @ squeezed))[:, None, None]
        for i in range(3, 8):
            x = np.maximum(layer(f"model_R.conv{i}", x, 1), 0)
        R = P + layer("model_R.conv8", x, 1)
        x = Q
        for i in range(1, 5):
            x = leaky(layer(f"model_L.conv{i}", x, 2))
        L = np.maximum(layer("model_L.conv5", x, 0), 0)
        rounds += [P, Q, R, L]
    x = np.concatenate([L, np.full_like(L, ratio)])
    for i in range(1, 4):
        x = leaky(layer(f"model_A.conv{i}", x, 2))
    return rounds, np.maximum(layer("model_A.conv4", x, 2), 0) * R


def test_three_rounds_of_closed_steps_and_networks(conv_by_hand):
    made, picture = network(), np.random.default_rng(0).uniform(0, 0.4, (3, 5, 6))
    rounds, wanted = by_hand(made, picture, 3.0, conv_by_hand)
    given = torch.from_numpy(picture)[None]
    found = [value for each in made.unfolded(given) for value in each]
    assert len(found) == len(rounds) == 12
    for mine, theirs in zip(found, rounds, strict=True):
        assert theirs.std() > 1e-4
        np.testing.assert_allclose(mine[0].detach(), theirs, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(made(given, 3.0)[0].detach(), wanted, rtol=1e-9, atol=1e-11)
    assert wanted.std() > 1e-4


def test_official_files_have_these_tensors_and_make_dark_photographs_bright(official, dark_fox, plausible):
    config = URetinexConfig(weights=(official("uretinex_L_adjust.pth"),))
    own = URetinex().state_dict()
    tensors = renamed(read_weights(config.weights))
    assert {n: v.shape for n, v in tensors.items()} == {n: v.shape for n, v in own.items()}
    for dark, bright in dark_fox:
        plausible(dark, URETINEX.enhance(torch.from_numpy(dark), config, None, None)[0].numpy(), bright)


def test_the_three_official_files_together_are_the_last_one(official):
    paths = tuple(official(f"uretinex_{name}.pth") for name in ("L_adjust", "init_low", "unfolding"))
    one, three = (URETINEX.load(URetinexConfig(weights=given)).state_dict() for given in (paths[:1], paths))
    assert all(torch.equal(value, three[name]) for name, value in one.items())


def test_the_other_files_alone_are_not_the_network(official):
    for name in ("uretinex_init_low.pth", "uretinex_unfolding.pth"):
        with pytest.raises(ValueError, match="another network"):
            URETINEX.load(URetinexConfig(weights=(official(name),)))


def test_official_reflectance_times_illumination_is_the_picture(official, dark_fox):
    """What the choices stand on that neither the paper nor the files state."""
    network = URETINEX.load(URetinexConfig(weights=(official("uretinex_L_adjust.pth"),)))
    dark = torch.from_numpy(dark_fox[0][0]).float().movedim(-1, 0)[None]
    R, L = network.model_decom(dark)
    assert float((R * L - dark).abs().mean()) < 0.01
    P, Q, R, L = network.unfolded(dark)[-1]
    assert float((Q - L).abs().mean()) < 0.03

    def rough(x: torch.Tensor) -> float:
        return float(x.diff(dim=2).abs().mean() + x.diff(dim=3).abs().mean())

    assert rough(R) < 0.9 * rough(network.unfolded(dark)[0][0])


@pytest.mark.parametrize("ratio", [0.0, -1.0, float("nan"), 1e4])
def test_ratios_that_cannot_be_are_refused(ratio):
    with pytest.raises(ValueError, match="ratio must lie in"):
        URetinexConfig(ratio=ratio)
