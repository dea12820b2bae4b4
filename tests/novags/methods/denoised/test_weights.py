"""The weights in the package, and files that hold no weights."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from novags.methods.denoised.estimate import estimate_all
from novags.methods.denoised.network import Network, NetworkConfig
from novags.methods.denoised.packing import filled, mask_of
from novags.methods.denoised.weights import PACKAGED, load_weights, made_by, save_weights
from sensor_model.params import Cfa

SMALL = NetworkConfig(widths=(4, 8), blocks=(1, 1))
LARGEST = 2_000_000  # bytes


def test_the_weights_of_the_package_are_small_and_say_how_they_were_made() -> None:
    assert PACKAGED.stat().st_size < LARGEST
    made = made_by()
    assert made["command"].startswith("python scripts/train_denoiser.py ")
    assert f"--seed {made['seed']}" in made["command"]
    assert made["steps"] > 1000
    assert not {"tabletop", "cornell", "market", "studio", "courtyard", "hall", "lantern", "thicket"} & {
        name.partition("-")[0] for name in made["sets"]
    }
    assert all(value.dtype == torch.float16 for value in load_file(PACKAGED).values())


def scene(size: int = 96) -> torch.Tensor:
    """A picture like none of the training's: ellipses, a chequered strip and a ramp, electrons [1, 3, size, size]."""
    rgb = np.full((4 * size, 4 * size, 3), (9.0, 14.0, 11.0))
    rgb *= np.linspace(0.4, 1.8, 4 * size)[:, None, None]
    for k in range(9):
        colour = np.array([4.0 + 3 * k, 30.0 - 2 * k, 6.0 + 2 * (k % 3)])
        centre = (int(40 + 350 * ((k * 0.37) % 1)), int(30 + 340 * ((k * 0.61) % 1)))
        cv2.ellipse(rgb, centre, (30 + 5 * k, 14 + 4 * k), 40 * k, 0, 360, colour.tolist(), -1)
    rgb[300:348] = np.where(np.arange(4 * size)[None, :, None] // 24 % 2, 25.0, 7.0)
    small = cv2.resize(rgb, (size, size), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(small).float().permute(2, 0, 1)[None]


@pytest.mark.parametrize(("cfa", "margin"), [(None, 1.5), ("RGGB", 1.5)])
def test_the_weights_beat_the_best_blur_by_far(cfa: Cfa | None, margin: float) -> None:
    """Of the mean squared error in square-root light, dB, at about 15 electrons and a read noise of 1.2."""
    mean, mask = scene(), mask_of((96, 96), cfa)
    stream = torch.Generator().manual_seed(0)
    noisy = (torch.poisson(mean, generator=stream) + 1.2 * torch.randn(mean.shape, generator=stream)) * mask

    def db(found: torch.Tensor) -> float:
        return float(-10 * torch.log10((found.clamp_min(0).sqrt() - mean.sqrt()).square().mean()))

    whole = filled(noisy, mask)[0].permute(1, 2, 0).numpy()
    blurs = [cv2.GaussianBlur(whole, (0, 0), sigma) for sigma in (0.6, 0.8, 1.0, 1.3, 1.7, 2.2)]
    best = max(db(torch.from_numpy(b).permute(2, 0, 1)[None]) for b in blurs)
    found = estimate_all(load_weights(), noisy, mask, torch.full((3,), 1.44), turns=1)
    assert db(found) > best + margin


def test_a_network_survives_half_precision_and_a_file(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = Network(SMALL)
    save_weights(tmp_path / "w.safetensors", network, {"command": "c", "seed": 3})
    found = load_weights(tmp_path / "w.safetensors")
    assert found.config == SMALL
    assert made_by(tmp_path / "w.safetensors") == {"command": "c", "seed": 3}
    for name, value in network.state_dict().items():
        torch.testing.assert_close(found.state_dict()[name], value, rtol=1e-3, atol=1e-7)


def test_a_loaded_network_can_be_trained_without_changing_the_next_one(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(path, Network(SMALL), {})
    with torch.no_grad():
        load_weights(path).enter.bias.add_(1.0)  # type: ignore[union-attr]
    assert not torch.equal(load_weights(path).enter.bias + 1, load_weights(path).enter.bias)  # type: ignore[operator]
    torch.testing.assert_close(load_weights(path).state_dict()["enter.bias"].half(), load_file(path)["enter.bias"])


def test_files_that_are_no_weights_are_refused_in_one_line(tmp_path: Path) -> None:
    save_weights(tmp_path / "good", Network(SMALL), {})
    whole = (tmp_path / "good").read_bytes()
    (tmp_path / "cut").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text").write_text("no weights")
    tensors = load_file(tmp_path / "good")
    save_file(tensors, tmp_path / "bare")
    about = {"made": "{}", "config": '{"widths": [4, 8], "blocks": [1, 2]}'}
    save_file(tensors, tmp_path / "other", about)
    save_file(tensors, tmp_path / "odd", about | {"config": '{"depth": 3}'})
    save_file({**tensors, "enter.bias": tensors["enter.bias"] * float("nan")}, tmp_path / "nan",
              about | {"config": '{"widths": [4, 8], "blocks": [1, 1]}'})  # fmt: skip
    for name in ("cut", "text", "bare", "other", "odd", "nan", "missing"):
        with pytest.raises(ValueError, match=name) as refused:
            load_weights(tmp_path / name)
        assert "\n" not in str(refused.value), name
