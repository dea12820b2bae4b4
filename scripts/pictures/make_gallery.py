"""Every scene of the catalogue in good light and at four light levels: docs/gallery/NAME.jpg, and the list in the page.

    python scripts/pictures/make_gallery.py [--spp 256] [--work DIR] [--missing]

One view of each scene, exposed by a real camera and brightened to the same exposure at every level. With --work the
renders are kept there (renders of make_scene_thumbnails.py serve both). With --missing only scenes that have no picture
yet are rendered: make_docs.py asks for that. Pictures of scenes that are gone are removed.
"""

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np
from make_scene_thumbnails import VIEWS, render
from numpy.typing import NDArray
from PIL import Image

from novags.commands.answers.catalogue import first_sentence
from novags.process import settle
from novags.testbed.stages.capturing import expose_view
from sensor_model import PRESETS, Exposure, develop
from sensor_model.isp import to_srgb8
from simscenes import SCENES

LEVELS = (500.0, 50.0, 5.0, 0.5)  # e- per pixel, mean of green over the view
SENSOR = "a7s2-iso6400"
WIDTH, GAP = 160, 4  # px
MIDDLE = 0.18  # linear; where the median of green is shown
PAGE = Path(__file__).resolve().parents[2] / "docs" / "gallery.md"


def strip(radiance: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The view in good light and at every level, side by side, uint8 sRGB."""
    sensor, exposure = PRESETS[SENSOR], Exposure(time=1 / 30)
    mean, median = float(radiance[..., 1].mean()), float(np.median(radiance[..., 1]))
    shown = MIDDLE / median
    parts = [to_srgb8(shown * radiance)]
    for electrons in LEVELS:
        frame = expose_view(radiance, sensor, exposure, electrons=electrons, mean_green=mean, seed=0, view=0)
        gain = shown * mean * (sensor.white_dn - sensor.black_level) / (electrons * sensor.gain)
        parts.append(develop(frame, sensor, digital_gain=gain).srgb8)
    gap = np.full((parts[0].shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1], axis=1)


def listed(names: list[str]) -> str:
    """The list of scenes in the page."""
    return "\n".join(
        f"**{name}**: {first_sentence(SCENES[name].text)}\n\n![{name}](gallery/{name}.jpg)\n" for name in names
    )


def main() -> None:
    """Render, expose, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--spp", type=int, default=256, help="samples per pixel")
    parser.add_argument("--work", type=Path, help="where renders are kept; none: they are not")
    parser.add_argument("--missing", action="store_true", help="only scenes that have no picture yet")
    args = parser.parse_args()
    names, folder = sorted(SCENES), PAGE.parent / "gallery"
    folder.mkdir(exist_ok=True)
    there = {path.stem for path in folder.iterdir()}
    for name in there - set(names):
        (folder / f"{name}.jpg").unlink()
    with tempfile.TemporaryDirectory() as temporary:
        for name in [name for name in names if not (args.missing and name in there)]:
            radiance = render(name, VIEWS // 2, WIDTH, args.spp, args.work or Path(temporary))
            Image.fromarray(strip(radiance)).save(folder / f"{name}.jpg", quality=70)
            print(name, flush=True)
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(re.sub(r"(<!-- scenes -->\n).*?(<!-- end -->)", lambda m: f"{m[1]}\n{listed(names)}\n{m[2]}", text,
                           flags=re.S), encoding="utf-8")  # fmt: skip
    print(f"{sum(path.stat().st_size for path in folder.iterdir()) / 1000:.0f} kB")


if __name__ == "__main__":
    settle()
    main()
