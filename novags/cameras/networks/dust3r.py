"""Cameras and points from DUSt3R, with the user's own installation and weights (both CC BY-NC-SA 4.0).

Parts of the package in use: `dust3r.model.AsymmetricCroCo3DStereo`, `dust3r.image_pairs.make_pairs`,
`dust3r.inference.inference` and `dust3r.cloud_opt.global_aligner`, as its README calls them. The results: poses
camera-to-world, focal lengths and principal points in px of the prepared pictures with pixel centres at 0, 1, ..., and
a world point and a confidence for each pixel.

Weights are read here and given to the model class: the package's own loader would run code that a pickle may hold.
"""

import argparse
import ast
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate
from novags.cameras.networks.dense import Window, choose, from_pixels, inverted, numbers, prepare, with_lens
from novags.cameras.networks.package import brief, part, read_checkpoint, require
from novags.cameras.pictures import check_views
from novags.cameras.sources.dust3r import Dust3rConfig
from sensor_model.files.records import read_json

SIZE, PATCH = 512, 16  # px: the longer side of the pictures that the networks were trained on, and their raster
RATE = 0.01  # of the alignment, with a cosine schedule, as in its README


def check_installed(config: Dust3rConfig) -> None:
    """Raise a ValueError that says what to do if the package or the weights are missing."""
    require(
        "dust3r", "dust3r", "clone https://github.com/naver/dust3r with --recursive, install its requirements.txt into "
        "this environment and add the folder of the clone to PYTHONPATH (CC BY-NC-SA 4.0: non-commercial use only)",
        config.checkpoint, "DUSt3R_ViTLarge_BaseDecoder_512_dpt (Hugging Face: model.safetensors and config.json)",
    )  # fmt: skip


def dust3r_cameras(
    pictures: NDArray[np.uint8],
    colors_from: Tensor,
    *,
    n_points: int,
    config: Dust3rConfig,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras, intrinsics and points as network and global alignment estimate them; every view has a camera.

    Args:
        pictures: [C, h, w, 3] uint8, the network's input. Of square ones it sees the middle three quarters.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: Maximum number of points.
        config: Weights and settings.
        seed: Of the alignment's start and of the choice of points.
        device: Where the network runs; about 2.3 GB of weights, and every ordered pair of views is one pass.

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
    model_class = part("dust3r", "dust3r.model").AsymmetricCroCo3DStereo
    make_pairs = part("dust3r", "dust3r.image_pairs").make_pairs
    infer = part("dust3r", "dust3r.inference").inference
    cloud = part("dust3r", "dust3r.cloud_opt")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = load(model_class, config.checkpoint, device)
        pairs = paired("dust3r", make_pairs, views, config.pairs)
        output = infer(pairs, model, device, batch_size=1, verbose=False)
        # Also for two views, for which its other mode would keep the cameras of one of the two passes.
        scene = cloud.global_aligner(
            output, device=device, mode=cloud.GlobalAlignerMode.PointCloudOptimizer, verbose=False
        )
        scene.compute_global_alignment(init="mst", niter=config.iterations, schedule="cosine", lr=RATE)
    points, confidence = numbers(scene.get_pts3d()), numbers(scene.im_conf)
    usable = np.asarray(np.isfinite(points).all(-1))
    chosen = choose("dust3r", confidence, usable, config.drop_percent, n_points, seed)
    return from_pixels("dust3r", chosen, points[tuple(chosen.T)], *cameras_of(scene), window, colors_from)


def paired(source: str, make_pairs: Any, views: list[dict[str, Any]], graph: str) -> Any:
    """The ordered pairs of a scene graph, as `make_pairs` of the package (DUSt3R or MASt3R) forms them.

    Raises:
        ValueError: If the package forms none, which is how it treats a graph that it does not know.
    """
    pairs = make_pairs(views, scene_graph=graph, prefilter=None, symmetrize=True)
    if not pairs:
        raise ValueError(
            f"pairs of {source} must be a scene graph of its make_pairs (complete, swin-5, logwin-4, oneref, ...), got "
            f"{graph!r}, for which it forms no pairs"
        )
    return pairs


def cameras_of(scene: Any) -> tuple[Array, Array]:
    """World-to-camera matrices [C, 4, 4] and intrinsics [C, 3, 3] of an alignment; MASt3R's is asked alike."""
    focals, centres = numbers(scene.get_focals()).reshape(-1), numbers(scene.get_principal_points())
    return inverted(numbers(scene.get_im_poses())), with_lens(focals, centres)


def as_its_loader(pictures: NDArray[np.uint8]) -> tuple[list[dict[str, Any]], Window]:
    """Pictures [C, h, w, 3] as its `load_images` at size 512 returns them, from files of these pictures.

    The longer side becomes 512 px, both are then cropped to whole patches about the middle, and square pictures to 4:3,
    the shape nearest to a square that the networks have seen.

    Raises:
        ValueError: If a side becomes shorter than a patch.
    """
    height, width = pictures.shape[1:3]
    factor = SIZE / max(height, width)
    wide, tall = round(width * factor), round(height * factor)
    kept_w, kept_h = wide // PATCH * PATCH, tall // PATCH * PATCH
    if kept_w == kept_h and wide == tall:
        kept_h = kept_h * 3 // 4
    if not (kept_w and kept_h):
        raise ValueError(
            f"pictures of {width} x {height} px are {wide} x {tall} px when their longer side is {SIZE}, and the "
            f"network needs {PATCH} px each way: use less elongated pictures"
        )
    offset = wide // 2 - kept_w // 2, tall // 2 - kept_h // 2
    shrunk = Image.Resampling.LANCZOS if max(height, width) > SIZE else Image.Resampling.BICUBIC
    images, window = prepare(pictures, (wide, tall), (kept_w, kept_h), offset, shrunk)
    shape = np.array([[kept_h, kept_w]], np.int32)
    views = [
        {"img": image[None] * 2 - 1, "true_shape": shape, "idx": i, "instance": str(i)}
        for i, image in enumerate(images)
    ]
    return views, window


def load(model_class: Any, checkpoint: Path, device: str | torch.device) -> Any:
    """A network of this family with its weights; MASt3R's are stored alike.

    Args:
        model_class: Its class, with a `load_state_dict`.
        checkpoint: model.safetensors of Hugging Face, with config.json beside it, the arguments of the class; or a .pth
            with "model", the weights, and "args", a Namespace whose `model` spells the class with its arguments.
        device: Where it will run.

    Raises:
        ValueError: If the file cannot be read safely, or arguments or weights do not belong to the class.
    """
    held = read_checkpoint(checkpoint)
    try:
        if checkpoint.suffix == ".safetensors":
            weights, arguments = held, read_json(checkpoint.parent / "config.json", infinite=True)
        else:
            weights, arguments = held["model"], spelled_arguments(held["args"], model_class.__name__)
        if max(arguments["img_size"]) != SIZE:
            raise ValueError(f"they are for pictures of {max(arguments['img_size'])} px, take the weights for {SIZE}")
        if arguments.get("patch_embed_cls") == "ManyAR_PatchEmbed":
            # The class it was trained with takes batches of mixed shapes; this one has the same weights for one shape.
            arguments["patch_embed_cls"] = "PatchEmbedDust3R"
        model = model_class(**arguments | {"landscape_only": False})
        missing = model.load_state_dict(weights, strict=False).missing_keys
        if missing:
            raise ValueError(f"{len(missing)} of its tensors are missing, {missing[0]} for one")
    except Exception as error:  # other keys, no config.json, other arguments, other names or shapes
        raise ValueError(
            f"{checkpoint} does not hold the weights of this {model_class.__name__}: {brief(error)}"
        ) from error
    return model.eval().to(device)


def spelled_arguments(namespace: argparse.Namespace, name: str) -> dict[str, Any]:
    """The keyword arguments of `Name(key=literal, ...)`, where `inf` is a literal too; nothing is evaluated.

    Raises:
        ValueError: If it is something else.
    """
    call = ast.parse(namespace.model, mode="eval").body
    if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == name and not call.args):
        raise ValueError(f"its arguments belong to {namespace.model[:60]!r}, not to {name}(...)")
    return {keyword.arg or "**": _literal(keyword.value) for keyword in call.keywords}


def _literal(node: ast.expr) -> Any:
    if isinstance(node, ast.Name) and node.id == "inf":
        return math.inf
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_literal(node.operand)
    if isinstance(node, ast.Tuple | ast.List):
        return tuple(_literal(part) for part in node.elts)
    return ast.literal_eval(node)
