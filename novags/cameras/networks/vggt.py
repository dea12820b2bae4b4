"""Cameras and points from VGGT, with the user's own installation and weights (neither is part of this project).

Parts of the package in use: `vggt.models.vggt.VGGT` with its `aggregator`, `camera_head`, `depth_head` and
`point_head`, and `vggt.utils.pose_enc.pose_encoding_to_extri_intri`. Pictures are prepared as its loader does in mode
"crop": 518 px wide, the height rounded to whole patches, cropped to the middle 518 px if it is larger.

Points are depths in the network's cameras, which is more accurate than its own points; those check the cameras.
"""

from collections.abc import Iterator
from contextlib import contextmanager
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
from novags.cameras.sources.vggt import VggtConfig

WIDTH, PATCH = 518, 14  # px, of the pictures that the network was trained on


def check_installed(config: VggtConfig) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "vggt", "vggt", "install it into this environment from its GitHub repository facebookresearch/vggt (mind its "
        "licence)", config.checkpoint, "those of VGGT-1B",
    )  # fmt: skip


def vggt_cameras(
    pictures: NDArray[np.uint8],
    colors_from: Tensor,
    *,
    n_points: int,
    config: VggtConfig,
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
        device: Where the network runs; about 5 GB of weights.

    Returns:
        In the network's frame: the frame of the first camera, in a unit of its own. `Ks` are the network's, at the size
        of `pictures`; they belong to its depths, so they are not replaced by known ones.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if the network
            returns values that are not finite, no positive depth, or cameras that its own points contradict.
    """
    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points, fewest=1)
    check_installed(config)
    prepared, window = as_its_loader(pictures)
    with torch.random.fork_rng():  # its class draws first weights, which are then replaced
        model = with_weights(part("vggt", "vggt.models.vggt").VGGT(), config.checkpoint, "this VGGT", device)
    return estimate_of(
        "vggt", _infer(model, prepared.to(device)), window, colors_from, n_points=n_points,
        drop_percent=config.drop_percent, seed=seed,
    )  # fmt: skip


def as_its_loader(pictures: NDArray[np.uint8]) -> tuple[Tensor, Window]:
    """Pictures [C, h, w, 3] as the network expects them, float32 [C, 3, H, W] in 0..1."""
    height, width = pictures.shape[1:3]
    tall = max(PATCH, round(height * (WIDTH / width) / PATCH) * PATCH)
    kept, top = min(tall, WIDTH), max(0, (tall - WIDTH) // 2)
    return prepare(pictures, (WIDTH, tall), (WIDTH, kept), (0, top), Image.Resampling.BICUBIC)


def _infer(model: Any, images: Tensor) -> NetworkAnswer:
    decode = part("vggt", "vggt.utils.pose_enc").pose_encoding_to_extri_intri
    with torch.no_grad():
        batch = images[None]
        with _half_precision(images.device):
            tokens, patch_start = model.aggregator(batch)
        # The heads need float32: poses in half precision are off by a tenth of a degree.
        encoding = model.camera_head(tokens)[-1]
        extrinsics, intrinsics = decode(encoding, batch.shape[-2:])
        depths, confidence = model.depth_head(tokens, batch, patch_start)
        points, _ = model.point_head(tokens, batch, patch_start)
    extrinsics, intrinsics, depths, confidence, points = (
        numbers(values[0]) for values in (extrinsics, intrinsics, depths[..., 0], confidence, points)
    )
    return NetworkAnswer(extrinsics, intrinsics, depths, confidence, points)


@contextmanager
def _half_precision(device: torch.device) -> Iterator[None]:
    """The precision that the authors run the backbone in on a GPU; float32 elsewhere."""
    if device.type != "cuda":
        yield
        return
    kind = torch.bfloat16 if torch.cuda.get_device_capability(device)[0] >= 8 else torch.float16
    with torch.autocast("cuda", dtype=kind):
        yield
