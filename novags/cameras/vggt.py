"""Cameras and points from VGGT, with the user's own installation and weights (neither is part of this project).

Parts of the package in use: `vggt.models.vggt.VGGT` with its `aggregator`, `camera_head` and `depth_head`, and
`vggt.utils.pose_enc.pose_encoding_to_extri_intri`. Pictures are prepared as its loader does in mode "crop": 518 px
wide, the height rounded to whole patches, cropped to the middle 518 px if it is larger.
"""

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate, as_estimate
from novags.cameras.points import averaged, subset, unproject
from novags.cameras.sfm import Pictures

WIDTH, PATCH = 518, 14  # px, of the pictures that the network was trained on


@dataclass(frozen=True, kw_only=True)
class VggtConfig:
    """Weights, and which of the network's depths to believe."""

    checkpoint: Path  # of VGGT-1B: a .pt or .safetensors file
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    drop_percent: float = 30.0  # of all pixels, those with the least confident depth give no points

    def __post_init__(self) -> None:
        if self.pictures not in get_args(Pictures):
            raise ValueError(f"pictures of vggt must be one of {', '.join(get_args(Pictures))}, got {self.pictures!r}")
        if not 0 <= self.drop_percent < 100:
            raise ValueError(f"drop_percent of vggt must lie in [0, 100), got {self.drop_percent}")


def check_installed(config: VggtConfig) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    if importlib.util.find_spec("vggt") is None:
        raise ValueError(
            "cameras vggt need the package vggt, which is not installed: install it into this environment from its "
            "GitHub repository facebookresearch/vggt (mind its licence), and give its weights as vggt:checkpoint=FILE"
        )
    if not config.checkpoint.is_file():
        raise ValueError(f"no VGGT weights at {config.checkpoint}: download them and give vggt:checkpoint=FILE")


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
        In the network's frame: that of the first camera, in a unit of its own. `Ks` are the network's, at the size of
        `pictures`; they belong to its depths, so they are not replaced by known ones.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if the network
            returns values that are not finite, or no positive depth.
    """
    pictures = np.asarray(pictures)
    if pictures.ndim != 4 or pictures.shape[-1] != 3 or pictures.dtype != np.uint8 or not len(pictures):
        raise ValueError(f"pictures must be uint8 [C, h, w, 3], got {pictures.dtype} {pictures.shape}")
    if tuple(colors_from.shape) != pictures.shape or n_points < 2:
        raise ValueError(
            f"colors_from must be {pictures.shape} like the pictures and n_points >= 2, got "
            f"{tuple(colors_from.shape)} and {n_points}"
        )
    check_installed(config)
    prepared, scale, offset = prepare(pictures)
    viewmats, Ks, depths, confidence = _infer(_load(config.checkpoint, device), prepared.to(device))
    threshold = np.percentile(confidence, config.drop_percent)
    good = np.argwhere((confidence >= threshold) & np.isfinite(depths) & (depths > 0))
    if not len(good):
        raise ValueError("VGGT returned no positive depth: the pictures may be too dark, try pictures=enhanced")
    view, y, x = subset(good, n_points, np.random.default_rng(seed)).T
    pixels = np.stack([x, y], -1) + 0.5
    points = unproject(pixels, depths[view, y, x], viewmats[view], Ks[view])
    # The same place in the original pictures; at their very edge, rounding may end just outside.
    column, row = np.minimum(((pixels + [0, offset]) / scale).astype(int), np.array(pictures.shape[2:0:-1]) - 1).T
    colors = colors_from.detach().cpu().double().numpy()[view, row, column]
    original = unprepared(Ks, scale, offset)
    made_of = {"of the network's depths": len(points)}
    return as_estimate(
        tuple(range(len(pictures))), viewmats, original, points, averaged(points, colors), made_of=made_of
    )


def prepare(pictures: NDArray[np.uint8]) -> tuple[Tensor, Array, int]:
    """Pictures as the network expects them.

    Returns:
        float32 [C, 3, H, W] in 0..1; the factors (x, y) by which they were scaled; the rows then cut off at the top.
        A pixel position p of the original, in pixels with centres at +0.5, is at p * factors - (0, rows).
    """
    height, width = pictures.shape[1:3]
    new_height = max(PATCH, round(height * (WIDTH / width) / PATCH) * PATCH)
    images = torch.from_numpy(pictures).movedim(-1, 1).float()
    # The loader resizes 8-bit pictures, so codes are rounded; antialiasing is what Pillow's bicubic filter does.
    images = F.interpolate(images, size=(new_height, WIDTH), mode="bicubic", antialias=True).round().clamp(0, 255) / 255
    offset = max(0, (new_height - WIDTH) // 2)
    return images[:, :, offset : offset + WIDTH], np.array([WIDTH / width, new_height / height]), offset


def unprepared(Ks: Array, scale: Array, offset: int) -> Array:
    """Intrinsics [C, 3, 3] of prepared pictures -> those of the original ones."""
    result = Ks.copy()
    result[:, 1, 2] += offset
    # Scaling keeps pixel edges in place, not centres, so with centres at +0.5 whole rows of K scale.
    result[:, :2] /= scale[:, None]
    return result


def _load(checkpoint: Path, device: str | torch.device) -> Any:
    from vggt.models.vggt import VGGT

    model = VGGT()
    try:
        if checkpoint.suffix == ".safetensors":
            from safetensors.torch import load_file

            weights = load_file(checkpoint)
        else:
            weights = torch.load(checkpoint, map_location="cpu", weights_only=True)
        model.load_state_dict(weights)
    except Exception as error:  # each format has errors of its own
        raise ValueError(f"{checkpoint} does not hold the weights of this VGGT: {error}") from error
    return model.eval().to(device)


def _infer(model: Any, images: Tensor) -> tuple[Array, Array, Array, Array]:
    """Cameras [C, 4, 4], intrinsics [C, 3, 3] of the prepared pictures, z-depths and confidence [C, H, W]; float64."""
    from vggt.utils.pose_enc import pose_encoding_to_extri_intri

    with torch.no_grad():
        batch = images[None]
        with _half_precision(images.device):
            tokens, patch_start = model.aggregator(batch)
        # The heads need float32: poses in half precision are off by a tenth of a degree.
        encoding = model.camera_head(tokens)[-1]
        extrinsics, intrinsics = pose_encoding_to_extri_intri(encoding, batch.shape[-2:])
        depths, confidence = model.depth_head(tokens, batch, patch_start)
    found = [values[0].double().cpu().numpy() for values in (extrinsics, intrinsics, depths[..., 0], confidence)]
    if not all(np.isfinite(values).all() for values in (found[0], found[1])):
        raise ValueError("VGGT returned cameras that are not finite: check the weights, or run it with --device cpu")
    viewmats = np.tile(np.eye(4), (len(images), 1, 1))
    viewmats[:, :3] = found[0]
    return viewmats, found[1], found[2], found[3]


@contextmanager
def _half_precision(device: torch.device) -> Iterator[None]:
    """The precision that the authors run the backbone in on a GPU; float32 elsewhere."""
    if device.type != "cuda":
        yield
        return
    kind = torch.bfloat16 if torch.cuda.get_device_capability(device)[0] >= 8 else torch.float16
    with torch.autocast("cuda", dtype=kind):
        yield
