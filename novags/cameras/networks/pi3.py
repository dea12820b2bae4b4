"""Cameras and points from π³ or π³-X, with the user's own installation and weights: neither is in this project.

Parts of the package in use (github.com/yyfz/Pi3, BSD-3-Clause, May 2026): `pi3.models.pi3.Pi3` and
`pi3.models.pi3x.Pi3X`, called in float32. Pictures are prepared as its `load_images_as_tensor` does: all of one size,
sides multiples of 14 px, at most 255,000 px in all, by Lanczos, in 0..1.

Poses are camera-to-world, also those that π³-X is told; its pixel edges are at whole numbers. Neither network has
intrinsics: they are fitted to the points in the cameras, with the principal point in the middle, as in its examples.
"""

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate
from novags.cameras.networks.dense import Window, inverted, numbers, prepare
from novags.cameras.networks.depths import NetworkAnswer, estimate_of, told
from novags.cameras.networks.package import part, require, with_weights
from novags.cameras.pictures import check_views
from novags.cameras.sources.pi3 import Pi3Config
from simscenes.rigs import Rig

PATCH, PIXELS = 14, 255_000  # px; px of a picture, at most


def check_installed(config: Pi3Config) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "pi3", "pi3", "pip install its GitHub repository yyfz/Pi3 into this environment (BSD-3-Clause)",
        config.checkpoint, f"model.safetensors of yyfz233/{'Pi3X' if config.network == 'pi3x' else 'Pi3'} from Hugging "
        "Face (CC BY-NC 4.0: non-commercial use only)",
    )  # fmt: skip


def pi3_cameras(
    pictures: NDArray[np.uint8],
    cameras: Rig,
    colors_from: Tensor,
    *,
    n_points: int,
    config: Pi3Config,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras and points as the network estimates them; every view has a camera.

    Args:
        pictures: [C, h, w, 3] uint8, the network's input.
        cameras: The set's, of which π³-X is told what `config.known` says.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: Maximum number of points.
        config: Weights, network, what is known, and threshold.
        seed: Of the choice of points.
        device: Where the network runs.

    Returns:
        In the network's frame and unit, of π³-X roughly metres; with known cameras in the set's. `Ks` are the set's
        unless nothing is known.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if the network
            returns values that are not finite, no positive depth, or cameras that its points contradict.
    """
    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points, cameras.Ks, fewest=2 if config.known == "cameras" else 1)
    check_installed(config)
    prepared, window = as_its_loader(pictures)
    viewmats, Ks = told("pi3", config.known, cameras, window)
    with torch.random.fork_rng():  # it draws first weights, which are then replaced, and at random what is certain
        torch.manual_seed(seed)
        found = _infer(_load(config, device), prepared.to(device), viewmats, Ks)
    return estimate_of(
        "pi3", found, window, colors_from, n_points=n_points, drop_percent=config.drop_percent, seed=seed,
        known=config.known, cameras=cameras,
    )  # fmt: skip


def as_its_loader(pictures: NDArray[np.uint8]) -> tuple[Tensor, Window]:
    """Pictures [C, h, w, 3] as the network expects them, float32 [C, 3, H, W] in 0..1."""
    height, width = pictures.shape[1:3]
    share = math.sqrt(PIXELS / (width * height)) / PATCH
    across, down = round(width * share), round(height * share)
    while across * down * PATCH**2 > PIXELS:
        if across * height > down * width:  # too wide for its shape
            across -= 1
        else:
            down -= 1
    size = max(1, across) * PATCH, max(1, down) * PATCH
    return prepare(pictures, size, size, (0, 0), Image.Resampling.LANCZOS)


def _load(config: Pi3Config, device: str | torch.device) -> Any:
    if config.network == "pi3":
        model = part("pi3", "pi3.models.pi3").Pi3()
    else:  # without the parts that only known cameras need; the file of weights has them
        model = part("pi3", "pi3.models.pi3x").Pi3X(use_multimodal=config.known != "nothing")
    hint = "; pi3:network=NAME says which network they are of"
    strict = config.network == "pi3"
    return with_weights(model, config.checkpoint, config.network, device, strict=strict, hint=hint)


def _infer(model: Any, images: Tensor, viewmats: Array | None, Ks: Array | None) -> NetworkAnswer:
    """Of the prepared pictures, with poses and intrinsics where they are known."""
    known = dict[str, Tensor]()
    if Ks is not None:
        known["intrinsics"] = images.new_tensor(Ks)[None]
    if viewmats is not None:
        known["poses"] = images.new_tensor(inverted(viewmats))[None]
    with torch.no_grad():
        found = model(images[None], **known)
    poses, local, points, confidence = (
        numbers(values[0])
        for values in (found["camera_poses"], found["local_points"], found["points"], found["conf"].sigmoid()[..., 0])
    )
    return NetworkAnswer(inverted(poses), fitted_lenses(local), local[..., 2], confidence, points)


def fitted_lenses(local: Array) -> Array:
    """Intrinsics [C, 3, 3] by least squares over all pixels, with the principal point in the middle.

    Args:
        local: The point of each pixel in the camera [C, H, W, 3], z > 0.
    """
    count, height, width, _ = local.shape
    Ks = np.tile(np.eye(3), (count, 1, 1))
    middle = np.array([width, height]) / 2
    offsets = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1) + 0.5 - middle
    slopes = local[..., :2] / local[..., 2:]
    Ks[:, [0, 1], [0, 1]] = (slopes * offsets).sum((1, 2)) / (slopes**2).sum((1, 2))
    Ks[:, :2, 2] = middle
    return Ks
