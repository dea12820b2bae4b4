"""Cameras and points from Depth Anything 3, with the user's own installation and weights: neither is in this project.

Parts of the package in use: `depth_anything_3.api.DepthAnything3(model_name)` and its network `model`, which is called
in float32: its owner's `forward` asks for a GPU's half precision. Pictures are prepared as its `InputProcessor` does by
default: longest side 504 px, each side then the nearest multiple of 14, by OpenCV (areas where a picture shrinks, else
cubic), minus mean and over deviation of ImageNet.

Depths are z-depths, cameras world-to-camera with pixel edges at whole numbers, also those that it is told. The network
has no points of its own; depths of one view seen from the next check the cameras.
"""

from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate
from novags.cameras.networks.dense import Window, normalised, numbers
from novags.cameras.networks.depths import NetworkAnswer, estimate_of, told
from novags.cameras.networks.package import part, require, with_weights
from novags.cameras.pictures import check_views
from novags.cameras.sources.da3 import Da3Config
from simscenes.rigs import Rig

LONGEST, PATCH = 504, 14  # px
REFERENCE = "saddle_balanced"  # its default for the view that others refer to


def check_installed(config: Da3Config) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "da3", "depth_anything_3", "pip install depth-anything-3 into this environment, or its GitHub repository "
        "ByteDance-Seed/Depth-Anything-3 (code and the weights SMALL and BASE: Apache-2.0; LARGE and GIANT: CC BY-NC "
        "4.0)", config.checkpoint, "model.safetensors of depth-anything/DA3-SMALL or another of its networks from "
        "Hugging Face (SMALL and BASE: Apache-2.0; LARGE and GIANT: CC BY-NC 4.0)",
    )  # fmt: skip


def da3_cameras(
    pictures: NDArray[np.uint8],
    cameras: Rig,
    colors_from: Tensor,
    *,
    n_points: int,
    config: Da3Config,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras, intrinsics and points as the network estimates them; every view has a camera.

    Args:
        pictures: [C, h, w, 3] uint8, the network's input.
        cameras: The set's, which the network is told if `config.known` says so.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: Maximum number of points.
        config: Weights, network, what is known, and threshold.
        seed: Of the choice of points.
        device: Where the network runs.

    Returns:
        In the network's frame and unit. `Ks` are the network's, at the size of `pictures`; they belong to its depths,
        so they are not replaced by known ones. With known cameras: these, and depths scaled to them.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if the network
            returns values that are not finite, no positive depth, or cameras of other conventions.
    """
    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points, cameras.Ks, fewest=2 if config.known == "cameras" else 1)
    check_installed(config)
    prepared, window = as_its_loader(pictures)
    viewmats, Ks = told("da3", config.known, cameras, window)
    with torch.random.fork_rng():  # its class draws first weights, which are then replaced
        model = part("da3", "depth_anything_3.api").DepthAnything3(model_name=config.network)
        hint = "; da3:network=NAME says which network they are of"
        model = with_weights(model, config.checkpoint, config.network, device, hint=hint).model
    return estimate_of(
        "da3", _infer(model, prepared.to(device), viewmats, Ks, config.rays), window, colors_from, n_points=n_points,
        drop_percent=config.drop_percent, seed=seed, known=config.known, cameras=cameras,
    )  # fmt: skip


def as_its_loader(pictures: NDArray[np.uint8]) -> tuple[Tensor, Window]:
    """Pictures [C, h, w, 3] as the network expects them, float32 [C, 3, H, W]."""
    height, width = pictures.shape[1:3]
    share = LONGEST / max(width, height)
    near = [(width, height), (max(1, round(width * share)), max(1, round(height * share)))]
    near.append((_patches(near[1][0]), _patches(near[1][1])))
    images = []
    for picture in pictures:
        for before, after in zip(near[:-1], near[1:], strict=True):
            grows = after[0] > before[0] or after[1] > before[1]
            if after != before:
                picture = cv2.resize(picture, after, interpolation=cv2.INTER_CUBIC if grows else cv2.INTER_AREA)
        images.append(picture)
    values = torch.from_numpy(np.stack(images)).movedim(-1, 1).float() / 255
    return normalised(values), Window(np.array(near[-1]) / [width, height], np.zeros(2), *near[-1])


def _patches(side: int) -> int:
    """The nearest multiple of PATCH, the larger of two that are as near; at least one px, as its loader says."""
    return max(1, (side + PATCH // 2) // PATCH * PATCH)


def _infer(model: Any, images: Tensor, viewmats: Array | None, Ks: Array | None, rays: bool) -> NetworkAnswer:
    """Of the prepared pictures, with cameras where they are known."""
    known = [None if values is None else images.new_tensor(values)[None] for values in (viewmats, Ks)]
    with torch.no_grad():
        found = model(images[None].float(), *known, [], False, rays, REFERENCE)
    count, _, height, width = images.shape
    extrinsics, intrinsics = numbers(found["extrinsics"][0]), numbers(found["intrinsics"][0])
    depths, confidence = (numbers(found[key][0]).reshape(count, height, width) for key in ("depth", "depth_conf"))
    return NetworkAnswer(extrinsics, intrinsics, depths, confidence)
