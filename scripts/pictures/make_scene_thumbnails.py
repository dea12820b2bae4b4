"""Render one small view of every catalogue scene into a captioned contact sheet, docs/scenes.png.

    python scripts/pictures/make_scene_thumbnails.py [--out docs/scenes.png] [--size 160] [--spp 256] [--columns 4]
        [--work DIR]
    python scripts/pictures/make_scene_thumbnails.py --scenes street market --views
        every view of the rig, to choose from

For looking at only: each picture has its own exposure and tone curve, and isolated bright values are taken out. With
--work the renders are kept there, and a second run only tones and arranges them.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import rank_filter

from sensor_model.isp import to_srgb8
from simscenes import SCENES, Rig, default_rig, render_set
from simscenes.sets.pictures.png import write_png

ASPECT = 3 / 4  # height over width
VIEWS = 9  # of each scene's own rig, of which the middle one is shown
EFFORT = {"gallery": 2, "street": 2}  # times the samples of the others: light through slits, light in fog
KEY = 0.3  # luminance that the log-average of a picture takes before highlights are compressed
LEVELS = 48  # of each channel: too fine to be seen, and a third off the file
MARGIN, CAPTION = 8, 24  # px, around pictures and below each
PAPER, INK = (255, 255, 255), (40, 40, 40)


def render(name: str, view: int, width: int, spp: int, work: Path) -> NDArray[np.float32]:
    """Radiance of one view of a scene, linear RGB [h,w,3]."""
    rig = default_rig(name, VIEWS, width, round(width * ASPECT))
    one = Rig(viewmats=rig.viewmats[[view]], Ks=rig.Ks[[view]], width=rig.width, height=rig.height)
    return render_set(name, one, work / f"{name}-{view}", spp=spp * EFFORT.get(name, 1)).radiance(0)


def toned(radiance: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A picture of it for the eye: uint8 sRGB [h,w,3], by Reinhard's photographic operator (2002, equation 4)."""
    # Fireflies: the two brightest values of each 3 x 3 neighbourhood count as the third.
    calm = np.minimum(radiance, rank_filter(radiance, -3, size=(3, 3, 1)))
    luminance = calm @ np.float32((0.2126, 0.7152, 0.0722))
    # The floor keeps black pixels, whose logarithm is infinite, from deciding the exposure.
    floor = 1e-3 * np.quantile(luminance, 0.99)
    scaled = luminance * KEY / np.exp(np.log(luminance + floor).mean())
    white = np.quantile(scaled, 0.995)
    shown = scaled * (1 + scaled / white**2) / (1 + scaled)
    # The ratio of a black pixel is 0 / 0 without a floor.
    return to_srgb8(calm * (shown / np.maximum(luminance, floor))[..., None])


def contact_sheet(pictures: dict[str, NDArray[np.uint8]], columns: int) -> NDArray[np.uint8]:
    """Pictures of one size [h,w,3] in rows, each above its caption."""
    import cv2

    height, width = next(iter(pictures.values())).shape[:2]
    rows = -(-len(pictures) // columns)
    step_y, step_x = height + CAPTION + MARGIN, width + MARGIN
    sheet = np.full((rows * step_y + MARGIN, columns * step_x + MARGIN, 3), PAPER, np.uint8)
    for k, (caption, image) in enumerate(pictures.items()):
        y, x = MARGIN + k // columns * step_y, MARGIN + k % columns * step_x
        sheet[y : y + height, x : x + width] = image
        place = (x + 1, y + height + CAPTION - 8)
        cv2.putText(sheet, caption, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    return sheet


def fewer_levels(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An 8-bit image on `LEVELS` evenly spaced values."""
    step = 255 / (LEVELS - 1)
    return np.rint(np.rint(image / step) * step).astype(np.uint8)


def pictures(args: argparse.Namespace, work: Path) -> dict[str, NDArray[np.uint8]]:
    """Every picture that was asked for, by caption."""
    found = {}
    for name in args.scenes:
        for view in range(VIEWS) if args.views else [VIEWS // 2]:
            caption = f"{name} {view}" if args.views else name
            found[caption] = toned(render(name, view, args.size, args.spp, work))
            print(caption, flush=True)
    return found


def main() -> None:
    """Render, arrange, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("docs/scenes.png"))
    parser.add_argument("--size", type=int, default=160, help="width of a picture, px")
    parser.add_argument("--spp", type=int, default=256, help="samples per pixel")
    parser.add_argument("--columns", type=int, default=4)
    parser.add_argument("--scenes", nargs="+", default=sorted(SCENES), choices=sorted(SCENES), metavar="NAME")
    parser.add_argument("--views", action="store_true", help=f"all {VIEWS} views of each scene, numbered")
    parser.add_argument("--work", type=Path, help="where renders are kept; none: they are not")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sheet = contact_sheet(pictures(args, args.work or Path(folder)), args.columns)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_png(args.out, fewer_levels(sheet))
    print(f"{args.out}: {args.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
