"""TOML and camera files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader


def some_rig(views: int = 4, width: int = 24, height: int = 18):
    from simscenes.rigs import orbit_rig

    return orbit_rig(views, width, height, 60, radius=3)


def pictures(folder: Path, names: list[str], width: int = 24, height: int = 18) -> None:
    """Small PNG photographs."""
    from simscenes.sets.pictures.png import write_png

    rng = np.random.default_rng(0)
    for name in names:
        write_png(folder / f"{name}.png", rng.integers(0, 255, (height, width, 3), dtype=np.uint8))


def make_sensor(folder: Path) -> None:
    from sensor_model import PRESETS, write_sensor

    for name, sensor in list(PRESETS.items())[::6]:
        write_sensor(folder / f"{name}.toml", sensor, comment="a camera")
    (folder / "all.toml").write_text(
        "gain = 1.5\neta = 0.5\nsigma_d = 2.0\nmu_e_sat = 4000\nblack_level = 60\nbits = 12\ndsnu = 1.0\nprnu = 0.01\n"
        'cfa = "RGGB"\nrgb_response = [0.5, 1, 0.7]\nrgb_bias = [1, 0, -1]\ndark_current = 3\nserial = 7\n'
    )


def read_sensor(folder: Path, file: Path) -> object:
    from sensor_model import read_sensor

    return read_sensor(file)


VARIANTS = """[variant.no-sh]
method = "nova"
sh_weight = "none"
[variant."x.y"]
method = "nova-fast"
fit.iterations = 100
fit.rates.means = 1.6e-4
denoiser.warmup_steps = 20
[variant.l1]
method = "naive-l1"
init_scale = 0.5
pictures = "16bit"
"""


def read_variants(folder: Path, file: Path) -> object:
    from novags.methods.variant import read_variants
    from novags.testbed.study.cells.presets import EXPERIMENTS, adapted

    return adapted(EXPERIMENTS["demo"], variants=tuple(read_variants(file)))


def make_frames(folder: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    lines = ["bits = 12", 'cfa = "none"', "[camera]", "eta = 0.6", "mu_e_sat = 900.0"]
    for kind, level in (("dark", 60), ("flat", 300)):
        for i, time in enumerate((0.01, 0.02)):
            (folder / kind / str(i)).mkdir(parents=True)
            for n in range(2):
                mean = level * (1 + i) if kind == "flat" else level + i
                dn = rng.normal(mean, 4, (8, 10)).round().astype(np.uint16)
                if n:
                    cv2.imwrite(str(folder / kind / str(i) / f"{n}.png"), dn)
                else:
                    np.save(folder / kind / str(i) / f"{n}.npy", dn)
            lines += [f'[stacks."{kind}/{i}"]', f"time = {time}"]
    (folder / "frames.toml").write_text("\n".join(lines))


def read_frames(folder: Path, file: Path) -> object:
    from novags.testbed.importing.calibration.frames import read_frames

    return read_frames(folder)


def make_transforms(folder: Path) -> None:
    import json

    from simscenes.sets.writers.camera_files import write_cameras

    pictures(folder / "images", ["a", "b", "c", "d"])
    write_cameras(folder, ["a", "b", "c", "d"], some_rig())
    for name in ("nb-info.json", "train_list.txt", "val_list.txt", "test_list.txt"):
        (folder / name).unlink()
    content = json.loads((folder / "transforms.json").read_text())
    content |= {"k1": 0.01, "k2": -0.002, "p1": 0.001}
    for frame in content["frames"]:
        frame |= {"w": 24, "h": 18}
    (folder / "transforms.json").write_text(json.dumps(content))


def read_transforms(folder: Path, file: Path) -> object:
    from novags.testbed.console.terminal import Console
    from novags.testbed.folders.set import open_source

    source = open_source(folder, Console(quiet=True))
    return source.radiance(0), source.views.points(), source.views.names, source.views.rig


def make_linear(folder: Path) -> None:
    from simscenes.sets.pictures.exr import write_exr
    from simscenes.sets.writers.camera_files import write_cameras

    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        write_exr(folder / "images" / f"{name}.exr", {c: rng.random((18, 24), np.float32) for c in "RGB"})
    write_cameras(folder, ["a", "b"], some_rig(2))
    text = (folder / "transforms.json").read_text().replace(".png", ".exr")
    (folder / "transforms.json").write_text(text)


def _frames() -> None:
    import cv2  # noqa: F401
    from PIL import Image  # noqa: F401

    import novags.testbed.importing.calibration.frames  # noqa: F401


def _sets() -> None:
    import PIL.Image  # noqa: F401
    import pycolmap  # noqa: F401

    import novags.testbed.folders.set  # noqa: F401


READERS = [
    Reader("TOML: a camera", make_sensor, read_sensor, ("*.toml",), share=8),
    Reader("TOML: variants", lambda f: (f / "v.toml").write_text(VARIANTS), read_variants, ("*.toml",), share=0.5),  # type: ignore[arg-type, return-value]
    Reader("frames of a camera", make_frames, read_frames, ("frames.toml", "*.npy", "*.png"), share=3, prepare=_frames),
    Reader("transforms.json", make_transforms, read_transforms, ("transforms.json",), share=10, prepare=_sets),
    Reader("transforms.json of EXR images", make_linear, read_transforms, ("transforms.json",), share=3, prepare=_sets),
]
