"""Cameras and points from VGGT-Ω, with the user's own installation and weights: neither is in this project.

Code and weights are under the FAIR Noncommercial Research License, so its sources were not read for this file: it rests
on facts about its interface of May 2026. Parts of the package in use: `vggt_omega.models.VGGTOmega`, called as a whole,
and `vggt_omega.utils.pose_enc.encoding_to_camera`. Its half precision is of GPUs alone: on a CPU it is float32.

Pictures are prepared as its loader does in mode "balanced": about 1,024 patches of 16 px, with the shape of the
pictures, cut to 2:1 or 1:2 where they are longer; bicubic, in 0..1.

Depths are z-depths, cameras world-to-camera with pixel edges at whole numbers and the principal point in the middle.
"""

import math
import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from novags.cameras.estimate import CameraEstimate
from novags.cameras.networks.dense import Window, numbers, prepare
from novags.cameras.networks.depths import NetworkAnswer, estimate_of
from novags.cameras.networks.package import part, require, with_weights
from novags.cameras.pictures import check_views
from novags.cameras.sources.vggt_omega import VggtOmegaConfig

PATCH, PATCHES, LONGEST = 16, 1024, 2.0  # px; of a picture, about; its longer side over the shorter one, at most
LICENCE = "FAIR Noncommercial Research License: research only"


def check_installed(config: VggtOmegaConfig) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "vggt-omega", "vggt_omega", "pip install its GitHub repository facebookresearch/vggt-omega into this "
        f"environment ({LICENCE})", config.checkpoint, "vggt_omega_1b_512.pt of facebook/VGGT-Omega from Hugging Face, "
        f"where access is asked for ({LICENCE})",
    )  # fmt: skip


def vggt_omega_cameras(
    pictures: NDArray[np.uint8],
    colors_from: Tensor,
    *,
    n_points: int,
    config: VggtOmegaConfig,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras, intrinsics and points as the network estimates them; every view has a camera.

    Args:
        pictures: [C, h, w, 3] uint8, the network's input.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: Maximum number of points.
        config: Weights and threshold.
        seed: Of the choice of points.
        device: Where the network runs; said to need 6 to 10 GB.

    Returns:
        In the network's frame, in a unit of its own. `Ks` are the network's, at the size of `pictures`; they belong to
        its depths, so they are not replaced by known ones.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if the network
            returns values that are not finite, no positive depth, or cameras of other conventions.
    """
    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points, fewest=1)
    check_installed(config)
    prepared, window = as_its_loader(pictures)
    with torch.random.fork_rng():  # its class draws first weights, which are then replaced
        model = part("vggt-omega", "vggt_omega.models").VGGTOmega()
        hint = "; of its files only vggt_omega_1b_512.pt is for cameras"
        model = with_weights(model, config.checkpoint, "this VGGTOmega", device, hint=hint)
    return estimate_of(
        "vggt-omega", _infer(model, prepared.to(device)), window, colors_from, n_points=n_points,
        drop_percent=config.drop_percent, seed=seed,
    )  # fmt: skip


def as_its_loader(pictures: NDArray[np.uint8]) -> tuple[Tensor, Window]:
    """Pictures [C, h, w, 3] as the network expects them, float32 [C, 3, H, W] in 0..1."""
    height, width = pictures.shape[1:3]
    shape = min(max(width / height, 1 / LONGEST), LONGEST)
    kept = PATCH * round(math.sqrt(PATCHES * shape)), PATCH * round(math.sqrt(PATCHES / shape))
    # The kept part of a picture that is cut is as wide as `shape` says, of the full height, or the other way round.
    scaled = (round(kept[0] * max(1.0, width / height / shape)), round(kept[1] * max(1.0, height / width * shape)))
    offset = (scaled[0] - kept[0]) // 2, (scaled[1] - kept[1]) // 2
    return prepare(pictures, scaled, kept, offset, Image.Resampling.BICUBIC)


def _infer(model: Any, images: Tensor) -> NetworkAnswer:
    """Of the prepared pictures."""
    decode = part("vggt-omega", "vggt_omega.utils.pose_enc").encoding_to_camera
    with torch.no_grad(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "CUDA is not available", UserWarning)  # it asks for a GPU's half precision
        found = model(images[None])
        extrinsics, intrinsics = decode(found["pose_enc"].float(), tuple(images.shape[-2:]))
    extrinsics, intrinsics, depths, confidence = (
        numbers(values[0]) for values in (extrinsics, intrinsics, found["depth"][..., 0], found["depth_conf"])
    )
    return NetworkAnswer(extrinsics, intrinsics, depths, confidence)
