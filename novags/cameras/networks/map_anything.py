"""Cameras and points from MapAnything, with the user's own installation and weights: neither is in this project.

Parts of the package in use (github.com/facebookresearch/map-anything, Apache-2.0, March 2026):
`mapanything.models.MapAnything(**config)` and its `infer`, in float32. Pictures are prepared as its `load_images` does
by default: scaled to cover the one of ten sizes whose shape is nearest, by Lanczos (bicubic where they grow), cut to
its middle, minus mean and over deviation of ImageNet.

Cameras are camera-to-world, also those that it is told, and pixel centres at 0, 1, ...; depths are z-depths.

Weights are read here and given to the class: `from_pretrained` leaves missing tensors at random. Weights that parts of
its configuration name are not loaded, as the package would by running pickles: all of them are in the file.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate
from novags.cameras.networks.dense import Window, inverted, normalised, numbers, prepare
from novags.cameras.networks.depths import NetworkAnswer, estimate_of, told
from novags.cameras.networks.package import brief, part, require, with_weights
from novags.cameras.pictures import check_views
from novags.cameras.sources.map_anything import MapAnythingConfig
from sensor_model.files.records import read_json
from simscenes.rigs import Rig

SIZES = ((518, 518), (518, 392), (518, 336), (518, 294), (518, 252), (518, 168), (392, 518), (336, 518), (294, 518),
         (252, 518))  # px, width and height  # fmt: skip


def check_installed(config: MapAnythingConfig) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "map-anything", "mapanything", "pip install its GitHub repository facebookresearch/map-anything into this "
        "environment (Apache-2.0)", config.checkpoint, "model.safetensors and config.json of "
        "facebook/map-anything-apache from Hugging Face into one folder (Apache-2.0; of facebook/map-anything: CC "
        "BY-NC 4.0)",
    )  # fmt: skip


def map_anything_cameras(
    pictures: NDArray[np.uint8],
    cameras: Rig,
    colors_from: Tensor,
    *,
    n_points: int,
    config: MapAnythingConfig,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras and points as the network estimates them; every view has a camera.

    Args:
        pictures: [C, h, w, 3] uint8, the network's input.
        cameras: The set's, of which the network is told what `config.known` says.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: Maximum number of points.
        config: Weights, what is known, and threshold.
        seed: Of the choice of points.
        device: Where the network runs.

    Returns:
        In the network's frame, that of the first camera, and unit, roughly metres; with known cameras in the set's.
        `Ks` are the set's unless nothing is known.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if the network
            returns values that are not finite, no positive depth, or cameras that its points contradict.
    """
    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points, cameras.Ks, fewest=2 if config.known == "cameras" else 1)
    check_installed(config)
    prepared, window = as_its_loader(pictures)
    viewmats, Ks = told("map-anything", config.known, cameras, window)
    with torch.random.fork_rng():  # it draws first weights, which are then replaced, and at random what is certain
        torch.manual_seed(seed)
        model = with_weights(_built(config.checkpoint), config.checkpoint, "MapAnything", device, strict=False)
        found = _infer(model, prepared.to(device), viewmats, Ks)
    return estimate_of(
        "map-anything", found, window, colors_from, n_points=n_points, drop_percent=config.drop_percent, seed=seed,
        known=config.known, cameras=cameras,
    )  # fmt: skip


def as_its_loader(pictures: NDArray[np.uint8]) -> tuple[Tensor, Window]:
    """Pictures [C, h, w, 3] as the network expects them, float32 [C, 3, H, W]."""
    height, width = pictures.shape[1:3]
    kept = min(SIZES, key=lambda size: abs(size[0] / size[1] - width / height))
    # Without the addition, which is the package's, rounding down may leave a side one px short.
    factor = max(kept[0] / width, kept[1] / height) + 1e-8
    scaled = int(width * factor), int(height * factor)
    offset = (scaled[0] - kept[0]) // 2, (scaled[1] - kept[1]) // 2
    resample = Image.Resampling.LANCZOS if factor < 1 else Image.Resampling.BICUBIC
    images, window = prepare(pictures, scaled, kept, offset, resample)
    return normalised(images), window


def _built(checkpoint: Path) -> Any:
    """The network that the config.json beside the weights describes.

    Raises:
        ValueError: If there is no such file, or the class cannot be made of it.
    """
    file = checkpoint.parent / "config.json"
    if not file.is_file():
        raise ValueError(f"no config.json beside {checkpoint}: it is with the weights on Hugging Face, download it too")
    model_class = part("map-anything", "mapanything.models").MapAnything
    try:
        return model_class(**_without_files(read_json(file, infinite=True)))
    except Exception as error:  # keys of another version, no connection, ...
        raise ValueError(
            f"MapAnything cannot be made as {file} says: {brief(error)}; its encoder comes through torch.hub "
            "(facebookresearch/dinov2, Apache-2.0), which needs a connection the first time"
        ) from error


def _without_files(config: dict[str, Any]) -> dict[str, Any]:
    """A configuration without other files of weights, in any of its parts."""
    plain = {name: _without_files(value) if isinstance(value, dict) else value for name, value in config.items()}
    if plain.get("uses_torch_hub"):
        plain["torch_hub_pretrained"] = False  # 4.5 GB for a giant
    return {name: None if name == "pretrained_checkpoint_path" else value for name, value in plain.items()}


def _infer(model: Any, images: Tensor, viewmats: Array | None, Ks: Array | None) -> NetworkAnswer:
    """Of the prepared pictures, with poses and intrinsics where they are known."""
    views: list[dict[str, Any]] = [{"img": image[None], "data_norm_type": ["dinov2"]} for image in images]
    for i, view in enumerate(views):
        if Ks is not None:
            view["intrinsics"] = images.new_tensor(_half_less(Ks[i : i + 1], 0.5))
        if viewmats is not None:
            view["camera_poses"] = images.new_tensor(inverted(viewmats[i : i + 1]))
            view["is_metric_scale"] = torch.tensor([False])
    with torch.no_grad():
        found = model.infer(views, minibatch_size=1, use_amp=False, apply_mask=True, mask_edges=True)
    poses, intrinsics, depths, confidence, points = (
        numbers(view[key][0] for view in found) for key in ("camera_poses", "intrinsics", "depth_z", "conf", "pts3d")
    )
    return NetworkAnswer(inverted(poses), _half_less(intrinsics, -0.5), depths[..., 0], confidence, points)


def _half_less(Ks: Array, half: float) -> Array:
    """Intrinsics [C, 3, 3] whose pixel positions count from half a pixel later."""
    result = Ks.copy()
    result[:, :2, 2] -= half
    return result
