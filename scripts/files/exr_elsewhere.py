"""Do other programs read the EXR files of sets and captures, and the same values? A line for each file and program.

    python scripts/files/exr_elsewhere.py SET/gt/0000.exr CAPTURE/truth/0000.exr

Needs OpenEXR and, in an environment of its own, what is to be tried: `pip install OpenImageIO`, `pip install bpy`
(Blender as a module). OpenImageIO's channels are compared with the values that `OpenEXR.File(path)` reads in its
default mode; of Blender the layers that it offers are listed.
"""

import importlib.util
import sys
from pathlib import Path

import numpy as np

Channels = dict[str, np.ndarray]  # [h,w] each


def with_openexr(path: Path) -> Channels:
    """Channels as OpenEXR reads them in its default mode: R, G and B of a layer come as one array under its name."""
    import OpenEXR

    found: Channels = {}
    with OpenEXR.File(str(path)) as file:
        for name, channel in file.channels().items():
            if channel.pixels.ndim == 2:
                found[name] = channel.pixels
                continue
            layer = "" if name in ("RGB", "RGBA") else f"{name}."
            found |= {f"{layer}{c}": channel.pixels[..., k] for k, c in enumerate("RGBA"[: channel.pixels.shape[-1]])}
    return found


def with_openimageio(path: Path) -> Channels:
    """Channels as OpenImageIO reads them, each in its own type."""
    import OpenImageIO as oiio

    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise ValueError(f"OpenImageIO does not open {path}: {oiio.geterror()}")
    spec = file.spec()
    found = {
        name: np.asarray(file.read_image(k, k + 1, spec.channelformat(k))).reshape(spec.height, spec.width)
        for k, name in enumerate(spec.channelnames)
    }
    file.close()
    return found


def layers_in_blender(path: Path) -> list[str]:
    """Layers that Blender's compositor offers of a file; of files with layers, its Python has no pixels."""
    import bpy

    node = bpy.data.node_groups.new("look", "CompositorNodeTree").nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(str(path.resolve()))
    return [socket.name for socket in node.outputs]


def main() -> None:
    """Look at the files named on the command line in every program that is installed."""
    for path in map(Path, sys.argv[1:]):
        own = with_openexr(path)
        if importlib.util.find_spec("OpenImageIO") is not None:
            theirs = with_openimageio(path)
            same = [n for n in own if n in theirs and np.array_equal(own[n], theirs[n], equal_nan=True)]
            said = ", ".join(sorted(own.keys() - set(same))) or "none"
            print(f"OpenImageIO: {path}: {len(same)} of {len(own)} channels are the same; lacking or differing: {said}")
        if importlib.util.find_spec("bpy") is not None:
            print(f"Blender: {path}: layers {', '.join(layers_in_blender(path))}")


if __name__ == "__main__":
    main()
