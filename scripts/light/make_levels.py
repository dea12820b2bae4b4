"""What the light levels look like: histograms and a table from real captures, for docs/light-levels.md.

    python scripts/light/make_levels.py [--scenes tabletop studio] [--size 128] [--views 12] [--spp 96] [--work DIR]

Writes docs/levels.svg and docs/tables/light-levels/levels.csv. With --work renders and captures are kept there.
"""

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "choices"))

from tables import rows, write_csv

from novags.process import settle
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.study.cells.levels import CHIPS, LEVELS
from sensor_model.isp import LINEAR16_BLACK, to_linear16

DOCS = Path(__file__).resolve().parents[2] / "docs"
QUIET = Console(quiet=True)
EIGHT = np.arange(-0.5, 256)  # edges of the codes
SIXTEEN = np.concatenate([-np.geomspace(4096, 1, 40), np.geomspace(1, 61440, 60)])  # codes above black


@dataclass(frozen=True)
class Look:
    """The measurements of one capture."""

    share8: NDArray  # of the 8-bit values, by code
    share16: NDArray  # of the 16-bit values, by bin of `SIXTEEN`
    mean: float  # 8-bit code
    black: float  # share of the 8-bit values that are 0
    bright: float  # 99 % quantile, 8-bit code
    snr: float  # dB, of the linear picture against the noise-free exposure
    electrons: float  # median over the pixels of green
    most: float  # 99.9 % quantile over the pixels of green, electrons


def look(capture: Capture) -> Look:
    """Measure all views of a capture."""
    count = range(len(capture.names))
    codes = np.concatenate([np.rint(255 * capture.srgb8(i)).ravel() for i in count])
    linear, clean = (np.stack([read(i) for i in count]).astype(np.float64)
                     for read in (capture.linear16, capture.clean_linear))  # fmt: skip
    above = to_linear16(linear).ravel().astype(np.float64) - LINEAR16_BLACK
    assert capture.sensor is not None
    green = clean[..., 1] * capture.sensor.capacity_e  # green has no white balance
    return Look(
        share8=np.histogram(codes, EIGHT)[0] / codes.size, share16=np.histogram(above, SIXTEEN)[0] / above.size,
        mean=float(codes.mean()), black=float((codes == 0).mean()), bright=float(np.quantile(codes, 0.99)),
        snr=float(10 * np.log10((clean**2).mean() / ((linear - clean) ** 2).mean())),
        electrons=float(np.median(green)), most=float(np.quantile(green, 0.999)),
    )  # fmt: skip


def table(looks: dict[tuple[str, str], Look], scenes: list[str]) -> str:
    """The measurements as Markdown."""
    lines = ["| level | scene | mean 8-bit code | 99 % below | black | SNR, dB | electrons: median, 99.9 % below |",
             "| --- | --- | ---: | ---: | ---: | ---: | ---: |"]  # fmt: skip
    for name in LEVELS:
        for scene in scenes:
            found = looks[scene, name]
            lines.append(f"| `{name}` | {scene} | {found.mean:.1f} | {found.bright:.0f} | {100 * found.black:.1f} % | "
                         f"{found.snr:.1f} | {rounded(found.electrons)}, {rounded(found.most)} |")  # fmt: skip
    return "\n".join(lines)


def rounded(value: float) -> str:
    """A number of three digits without an exponent."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def figure(looks: dict[tuple[str, str], Look], scenes: list[str], out: Path) -> None:
    """The histograms: a row for each scene, a column for each level."""
    names = [name for name in LEVELS if not name.endswith(CHIPS)]
    plt.rcParams.update({"svg.fonttype": "none", "font.size": 8, "svg.hashsalt": "levels"})
    shown, axes = plt.subplots(len(scenes), len(names), figsize=(10, 2.2 * len(scenes)), squeeze=False)
    for row, scene in zip(axes, scenes, strict=True):
        for ax, name in zip(row, names, strict=True):
            wide = LEVELS[name].pictures == "16bit"
            for twin, label, color in ((name, "demosaiced", "#0072b2"), (name + CHIPS, "three chips", "#c8590a")):
                share = looks[scene, twin].share16 if wide else looks[scene, twin].share8
                ax.stairs(share, SIXTEEN if wide else EIGHT, color=color, label=label, linewidth=1)
            ax.set_yscale("log")
            ax.set_ylim(1e-5, 1)
            ax.set_xscale("symlog", linthresh=10) if wide else ax.set_xlim(-3, 160)
            ax.set_xlabel("16-bit code above black, linear" if wide else "8-bit code, sRGB")
            ax.set_title(f"{name}, {scene}")
        row[0].set_ylabel("share of the values")
    axes[0, 0].legend(frameon=False)
    shown.tight_layout()
    shown.savefig(out, metadata={"Date": None})


def main() -> None:
    """Render, capture, measure, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=["tabletop", "studio"])
    parser.add_argument("--size", type=int, default=128, help="px")
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--spp", type=int, default=96, help="samples per pixel")
    parser.add_argument("--work", type=Path, help="where renders and captures are kept; none: they are not")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work, looks = args.work or Path(temporary), {}
        for scene in args.scenes:
            config = RenderConfig(scene=scene, n_views=args.views, width=args.size, height=args.size, spp=args.spp)
            stages.render(work / f"set-{scene}", config, QUIET)
            for name, level in LEVELS.items():
                folder = work / f"{name}-{scene}"
                exposed = CaptureConfig(sensor=level.sensor, electrons=level.electrons)
                stages.capture(work / f"set-{scene}", folder, exposed, QUIET)
                looks[scene, name] = look(open_capture(folder))
    figure(looks, args.scenes, DOCS / "levels.svg")
    made = table(looks, args.scenes)
    write_csv(DOCS / "tables" / "light-levels" / "levels.csv", rows(made))
    print(made)


if __name__ == "__main__":
    settle()
    main()
