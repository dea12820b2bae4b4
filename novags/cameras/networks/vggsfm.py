"""Cameras and points from VGGSfM, with the user's own installation and weights (both CC BY-NC 4.0).

It needs Python 3.10 and pycolmap 3.10, so it runs in an environment of its own, as a program: `python demo.py
SCENE_DIR=FOLDER` reads FOLDER/images and writes FOLDER/sparse, a COLMAP model whose cameras have the size of the
pictures. Views that it could not place are not in the model.
"""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from novags.cameras.estimate import CameraEstimate
from novags.cameras.motion.colmap import quiet
from novags.cameras.motion.mapping import from_reconstruction
from novags.cameras.networks.package import read_checkpoint, require_weights
from novags.cameras.pictures import check_views, write_pictures
from novags.cameras.sources.vggsfm import VggsfmConfig
from sensor_model.files.door import resolved
from sensor_model.files.reading import brief
from sensor_model.files.scratch import scratch

ADVICE = "more query_frames, more light, or --cameras known"


def check_installed(config: VggsfmConfig) -> None:
    """Raise a ValueError that says what to do if program, interpreter or weights are missing."""
    if not (config.home / "demo.py").is_file():
        raise ValueError(
            f"cameras vggsfm need the program VGGSfM, but {config.home} has no demo.py: clone "
            "https://github.com/facebookresearch/vggsfm, install it by its install.sh into an environment of its own "
            "(CC BY-NC 4.0: non-commercial use only), and give vggsfm:home=FOLDER,python=FILE,checkpoint=FILE"
        )
    # With a relative path, or a relative folder on PATH, the current folder would decide which interpreter that is.
    if not os.path.isabs(shutil.which(config.python) or ""):
        raise ValueError(
            f"VGGSfM runs in its own Python, and {config.python} cannot be run: give the absolute path of the "
            "interpreter in its environment as vggsfm:python=FILE"
        )
    require_weights("vggsfm", config.checkpoint, "vggsfm_v2_0_0.bin (Hugging Face: facebook/VGGSfM)")


def vggsfm_cameras(
    pictures: NDArray[np.uint8],
    colors_from: Tensor,
    *,
    n_points: int,
    config: VggsfmConfig,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> CameraEstimate:
    """Cameras, intrinsics and points as VGGSfM estimates them; views that it does not place have no camera.

    Args:
        pictures: [C, h, w, 3] uint8, its input.
        colors_from: [C, h, w, 3] dark images of the same views, 0..1.
        n_points: How many points. Where the model has fewer, random pixels with depths interpolated between observed
            points of their view are added.
        config: Where it is, weights and settings.
        seed: Of its random choices and of the choice of points.
        device: Where it runs; on the CPU, GPUs are hidden from it.

    Returns:
        In its own frame and unit. `Ks` are its own, at the size of `pictures`.

    Raises:
        ValueError: If something is missing, for wrong shapes or types, if the weights hold anything but tensors, if the
            program fails, or if it places fewer than 2 views.
    """
    import pycolmap

    pictures = np.asarray(pictures)
    check_views(pictures, colors_from, n_points)
    check_installed(config)
    read_checkpoint(config.checkpoint)  # the program unpickles it freely, so it must hold nothing but weights
    with scratch("vggsfm") as root:
        images = root / "images"
        images.mkdir()
        write_pictures(images, pictures)
        (root / "weights.bin").symlink_to(resolved(config.checkpoint))  # = and , in a path mean something to its parser
        _run(config, root, seed, torch.device(device))
        model = _model(root / "sparse", pycolmap)
        return from_reconstruction(
            model, colors_from, n_points, seed, what="vggsfm: VGGSfM", kind=config.pictures, advice=ADVICE
        )


def _run(config: VggsfmConfig, root: Path, seed: int, device: torch.device) -> None:
    command = [
        config.python, "demo.py", f"SCENE_DIR={root}", f"resume_ckpt={root / 'weights.bin'}",
        "auto_download_ckpt=False", "camera_type=SIMPLE_PINHOLE", f"shared_camera={config.shared_lens}",
        f"query_frame_num={config.query_frames}", f"max_query_pts={config.query_points}", f"seed={seed}",
    ]  # fmt: skip
    unseen = {"CUDA_VISIBLE_DEVICES": ""} if device.type == "cpu" else {}
    # Not this environment's modules: its own interpreter has other versions of them.
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")} | unseen
    done = subprocess.run(
        command, cwd=config.home, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, errors="replace", check=False,
    )  # fmt: skip
    if done.returncode:
        said = [line.strip() for line in done.stdout.splitlines() if line.strip()]
        raise ValueError(
            f"VGGSfM ended with exit code {done.returncode}: {said[-1][:300] if said else 'it said nothing'}; try "
            f"`{config.python} demo.py SCENE_DIR=examples/kitchen` in {config.home}"
        )


def _model(folder: Path, pycolmap: Any) -> Any:
    try:
        with quiet(pycolmap):
            return pycolmap.Reconstruction(folder)
    except Exception as error:
        raise ValueError(
            f"VGGSfM ended without an error, but its sparse folder holds no COLMAP model ({brief(error)}): use the "
            "version of its main branch, which writes SCENE_DIR/sparse"
        ) from error
