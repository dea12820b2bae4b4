"""COLMAP models, PLY files, safetensors and checkpoints."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader
from tests.fuzz.readers.keras import keras_bytes
from tests.fuzz.readers.text import pictures, read_transforms, some_rig


def make_colmap(folder: Path) -> None:
    from simscenes.sets.geometry.tracks import SparsePoints
    from simscenes.sets.writers.camera_files import write_cameras

    names = ["a", "b", "c"]
    pictures(folder / "images", names)
    rng = np.random.default_rng(0)
    xyz, rgb = rng.random((6, 3)) - 0.5, rng.integers(0, 255, (6, 3), np.uint8)
    points = SparsePoints.seen(some_rig(3), xyz, rgb, np.ones((3, 6), bool), exact=True)
    write_cameras(folder, names, some_rig(3), points=points)
    for name in ("transforms.json", "nb-info.json", "train_list.txt", "val_list.txt", "test_list.txt"):
        (folder / name).unlink()


def make_colmap_text(folder: Path) -> None:
    import pycolmap

    make_colmap(folder)
    model = pycolmap.Reconstruction(str(folder / "sparse/0"))
    for file in (folder / "sparse/0").iterdir():
        file.unlink()
    model.write_text(str(folder / "sparse/0"))


def make_ply(folder: Path) -> None:
    import torch

    from novags.splats.files.ply import write_ply
    from novags.splats.gaussians import Gaussians

    points = torch.rand(5, 3)
    for degree in (0, 1, 3):
        write_ply(folder / f"{degree}.ply", Gaussians.from_points(points, torch.rand(5, 3), sh_degree=degree))


def read_ply(folder: Path, file: Path) -> object:
    from novags.splats.files.ply import read_ply

    return read_ply(file)


SETTINGS: dict[str, object] = {"iterations": 10, "seed": 0, "sh_degree": 1, "refine_cameras": None}


def make_checkpoint(folder: Path) -> None:
    import torch

    from novags.splats.gaussians import Gaussians
    from novags.splats.training.checkpoint import TrainingState, save_checkpoint
    from novags.splats.training.updates.adam import Adam

    gaussians = Gaussians.from_points(torch.rand(4, 3), torch.rand(4, 3), sh_degree=1)
    adam = Adam(gaussians)
    adam.count = 3
    state = TrainingState(gaussians=gaussians, adam=adam, iteration=3, losses=[{"l1": 0.5, "iteration": 1}])
    save_checkpoint(folder / "c.safetensors", state, SETTINGS)


def read_checkpoint(folder: Path, file: Path) -> object:
    import torch

    from novags.splats.training.checkpoint import load_checkpoint

    return load_checkpoint(file, SETTINGS, torch.device("cpu"))


def _network():
    import torch

    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Conv2d(1, 2, 3), torch.nn.Conv2d(2, 1, 1))
    return network, torch.optim.Adam(network.parameters())


def make_network(folder: Path) -> None:
    import torch

    from novags.splats.files.tensors import write_tensors
    from novags.splats.training.companion import pack

    network, adam = _network()
    network(torch.rand(1, 1, 5, 5)).sum().backward()
    adam.step()
    write_tensors(folder / "n.safetensors", pack("denoiser", network, adam))


def read_network(folder: Path, file: Path) -> object:
    from novags.splats.files.tensors import read
    from novags.splats.training.companion import unpack

    network, adam = _network()
    unpack("denoiser", read(file), network, adam)
    return network.state_dict()


def _stand_in() -> None:
    """A package vggt of the same interface, small."""
    import torch

    class VGGT(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.head = torch.nn.Linear(3, 2)

    for name in ("vggt", "vggt.models", "vggt.models.vggt"):
        sys.modules.setdefault(name, types.ModuleType(name))
    sys.modules["vggt.models.vggt"].VGGT = VGGT  # type: ignore[attr-defined]
    import novags.cameras.networks.vggt  # noqa: F401


def make_weights(folder: Path) -> None:
    import torch
    from safetensors.torch import save_file

    weights = {"head.weight": torch.rand(2, 3), "head.bias": torch.rand(2)}
    torch.save(weights, folder / "w.pt")
    save_file(weights, folder / "w.safetensors")


def read_weights(folder: Path, file: Path) -> object:
    from novags.cameras.networks.package import part, with_weights

    return with_weights(part("vggt", "vggt.models.vggt").VGGT(), file, "this VGGT", "cpu").state_dict()


def make_enhancer(folder: Path) -> None:
    """In every layout that official files have: of torch since 1.6, of torch before, and safetensors."""
    import argparse

    import torch
    from safetensors.torch import save_file

    weights = {"a.weight": torch.rand(2, 3), "a.bias": torch.rand(2)}
    wrapped = {"epoch": 3, "state_dict": {"model_R": weights}, "opts": argparse.Namespace(rate=0.1, name="x")}
    torch.save(wrapped, folder / "w.pth")
    torch.save(wrapped, folder / "old.pth", _use_new_zipfile_serialization=False)
    save_file(weights, folder / "w.safetensors")
    arrays = {f"conv2d_1/conv2d_1/{name}": value.numpy() for name, value in weights.items()}
    (folder / "w.h5").write_bytes(keras_bytes(arrays))


def read_enhancer(folder: Path, file: Path) -> object:
    from novags.methods.enhancers.files.weights import read_weights

    return read_weights((file,))


def make_field(folder: Path) -> None:
    from novags.fields.box import Box
    from novags.fields.field import first_field
    from novags.fields.layout import FieldLayout
    from novags.fields.march import Proposal
    from novags.methods.nerf.scene import FieldScene

    field = first_field(FieldLayout(coarsest=2, finest=4, log2_rows=8, static=0, viewed=3), 0)
    box = Box(center=(0.0, 0.0, 0.0), half=(1.0, 1.0, 1.0), near=0.1, middle=3.0, far=50.0)
    FieldScene(field, box, Proposal(), 4, "light", {"unit": 0.5}).save(folder)


def read_field(folder: Path, file: Path) -> object:
    from novags.methods.nerf.scene import load_field

    found = load_field(folder)
    return None if found is None else found.render(_view())


def _view():
    import torch

    from novags.splats import Views

    return Views(torch.eye(4)[None], torch.tensor([[[4.0, 0, 1], [0, 4, 1], [0, 0, 1]]]), 2, 2)


def _wall():
    import torch

    from novags.methods.gaussian_scene import GaussianScene
    from novags.splats.gaussians import Gaussians

    torch.manual_seed(0)
    return GaussianScene(Gaussians.from_points(torch.rand(5, 3) + 1, torch.rand(5, 3), sh_degree=0))


def make_denoiser(folder: Path) -> None:
    import torch

    from novags.methods.rivals.denoised_scene import DenoisedScene, StagedDenoiser

    DenoisedScene(_wall(), torch.rand(5, 3), StagedDenoiser(2)).save(folder)


def read_denoiser(folder: Path, file: Path) -> object:
    from novags.methods.rivals.denoised_scene import with_denoiser

    return with_denoiser(_wall(), folder).render(_view())


def make_colours(folder: Path) -> None:
    import torch

    from novags.methods.rivals.le3d.colours import ColourNetwork, ColourScene

    ColourScene(_wall(), torch.rand(5, 16), torch.rand(5, 3), ColourNetwork()).save(folder)


def read_colours(folder: Path, file: Path) -> object:
    from novags.methods.rivals.le3d.colours import with_colours

    return with_colours(_wall(), folder).render(_view())


def _torch() -> None:
    import torch

    import novags.splats.files.ply  # noqa: F401

    torch.set_num_threads(1)


def _networks() -> None:
    _torch()
    import torch._dynamo  # noqa: F401  # an optimiser loads it: here once, and not in each child


def _enhancers() -> None:
    import torch

    import novags.methods.enhancers.files.weights  # noqa: F401

    torch.set_num_threads(1)


def _scenes() -> None:
    import torch

    import novags.methods.nerf.scene
    import novags.methods.rivals.denoised_scene
    import novags.methods.rivals.le3d.colours  # noqa: F401

    torch.set_num_threads(1)


def _sets() -> None:
    import pycolmap  # noqa: F401

    import novags.testbed.folders.set  # noqa: F401


READERS = [
    Reader("COLMAP, binary", make_colmap, read_transforms, ("sparse/*.bin",), cut=("*.bin",), share=10, prepare=_sets),
    Reader(
        "COLMAP, text", make_colmap_text, read_transforms, ("sparse/*.txt",), cut=("*.txt",), share=10, prepare=_sets
    ),
    Reader("PLY", make_ply, read_ply, ("*.ply",), cut=("0.ply",), share=10, prepare=_torch),
    Reader(
        "checkpoint of a fit", make_checkpoint, read_checkpoint, ("*.safetensors",), cut=("*",), share=8, prepare=_torch
    ),
    Reader("checkpoint of a network", make_network, read_network, ("*.safetensors",), share=2, prepare=_networks),
    Reader("weights of enhancers", make_enhancer, read_enhancer, ("*.*",), cut=("*",), share=6, prepare=_enhancers),
    Reader("field", make_field, read_field, ("scene/*",), cut=("scene/*",), share=6, prepare=_scenes),
    Reader(
        "denoiser of a scene", make_denoiser, read_denoiser, ("scene/*",), cut=("scene/*",), share=4, prepare=_scenes
    ),
    Reader("colours of a scene", make_colours, read_colours, ("scene/*",), cut=("scene/*",), share=4, prepare=_scenes),
    Reader("VGGT weights", make_weights, read_weights, ("w.*",), cut=("w.safetensors",), share=6, prepare=_stand_in),
]
