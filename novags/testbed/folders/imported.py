"""Files of a capture folder of kind "imported" besides its pictures: photographs of somebody else's camera.

lit/NNNN.png          the same views in good light, 8-bit sRGB, if they were given
truth/NNNN.exr        clean.R, clean.G, clean.B: clean long exposures in linear light, brought to the light of the
                      dark pictures (0 = black, 1 = white), if they were given
"""

from pathlib import Path

import numpy as np

from simscenes.sets.pictures.exr import read_exr, write_exr

CHANNELS = tuple(f"clean.{colour}" for colour in "RGB")


def write_clean(folder: Path, name: str, light: np.ndarray) -> None:
    """Write the noise-free exposure of a view, linear float32 [h,w,3]."""
    (folder / "truth").mkdir(exist_ok=True)
    planes = {channel: np.ascontiguousarray(light[..., c]) for c, channel in enumerate(CHANNELS)}
    write_exr(folder / "truth" / f"{name}.exr", planes)


def read_clean(path: Path) -> np.ndarray:
    """The file of `write_clean`.

    Raises:
        ValueError: If the file cannot be read or is something else.
    """
    channels, _ = read_exr(path)
    if missing := [name for name in CHANNELS if name not in channels]:
        raise ValueError(f"{path} lacks the channels {', '.join(missing)}: import again")
    return np.stack([channels[name] for name in CHANNELS], axis=-1).astype(np.float32)


MISSING = {  # of `capture_record.PARTS`: why a score or a method has nothing to go by, and a remedy
    "truth": "no noise-free exposure is known of these photographs: novags import takes --clean FOLDER (long exposures "
    "of the same views)",
    "lit": "nothing shows these views in good light: novags import takes --lit FOLDER (pictures of the same views)",
    "images16": "there are no 16-bit linear pictures: novags import takes 16-bit or raw files",
    "raw": "there are no raw frames: novags import takes raw files of undistorted pictures in their own size",
}
