"""Cameras and points from MASt3R, with the user's own installation and weights (both CC BY-NC-SA 4.0).

Parts of the package in use: `mast3r.model.AsymmetricMASt3R` and
`mast3r.cloud_opt.sparse_ga.sparse_global_alignment`, as its demo calls them, and `make_pairs` of the DUSt3R that comes
with it. Pictures, weights and conventions are DUSt3R's; dense points come as [H W, 3] in rows of the picture.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import CameraEstimate
from novags.cameras.networks.dense import choose, from_pixels, numbers
from novags.cameras.networks.dust3r import as_its_loader, cameras_of, load, paired
from novags.cameras.networks.package import part, require
from novags.cameras.pictures import check_views, write_pictures
from novags.cameras.sources.mast3r import Mast3rConfig
from sensor_model.files.scratch import scratch

RATES = 0.07, 0.014  # of the two stages of the alignment, as in its demo
MATCH_CONFIDENCE = 5.0  # below it a match does not count, as in its demo


def check_installed(config: Mast3rConfig) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "mast3r", "mast3r", "clone https://github.com/naver/mast3r with --recursive, install requirements.txt and "
        "dust3r/requirements.txt into this environment and add the folder of the clone to PYTHONPATH (CC BY-NC-SA 4.0: "
        "non-commercial use only)", config.checkpoint,
        "MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric (Hugging Face: model.safetensors and config.json)",
    )  # fmt: skip


def mast3r_cameras(
    pictures: NDArray[np.uint8],
    colors_from: Tensor,
    *,
    n_points: int,
    config: Mast3rConfig,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras, intrinsics and points as network and sparse global alignment estimate them; every view has a camera.

    Args:
        pictures: [C, h, w, 3] uint8, the network's input. Of square ones it sees the middle three quarters.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: Maximum number of points.
        config: Weights and settings.
        seed: Of the alignment and of the choice of points.
        device: Where the network runs; about 2.8 GB of weights, and every ordered pair of views is one pass.

    Returns:
        In the frame of the alignment, in a unit of its own. `Ks` are its own, at the size of `pictures`.

    Raises:
        ValueError: If package or weights are missing or do not fit, for wrong shapes or types, or if its output is not
            finite or contradicts itself.
    """
    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points)
    check_installed(config)
    views, window = as_its_loader(pictures)
    # First: importing this package makes the DUSt3R that comes with it importable.
    model_class = part("mast3r", "mast3r.model").AsymmetricMASt3R
    align = part("mast3r", "mast3r.cloud_opt.sparse_ga").sparse_global_alignment
    make_pairs = part("mast3r", "dust3r.image_pairs").make_pairs
    with scratch("mast3r") as root, torch.random.fork_rng():
        torch.manual_seed(seed)
        model = load(model_class, config.checkpoint, device)
        files = [str(root / name) for name in write_pictures(root, pictures)]  # it names views by their files
        pairs = paired("mast3r", make_pairs, views, config.pairs)
        scene = align(
            files, pairs, str(root / "cache"), model, lr1=RATES[0], niter1=config.iterations, lr2=RATES[1],
            niter2=config.iterations, device=device, opt_depth=True, shared_intrinsics=config.shared_lens,
            matching_conf_thr=MATCH_CONFIDENCE,
        )  # fmt: skip
        points_of_views, _, confidences = scene.get_dense_pts3d(clean_depth=True)  # from the cache
    shape = len(pictures), window.height, window.width
    points, confidence = numbers(points_of_views).reshape(*shape, 3), numbers(confidences).reshape(shape)
    usable = np.asarray(np.isfinite(points).all(-1))
    chosen = choose("mast3r", confidence, usable, config.drop_percent, n_points, seed)
    return from_pixels("mast3r", chosen, points[tuple(chosen.T)], *cameras_of(scene), window, colors_from)
