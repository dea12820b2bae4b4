"""A small valid project: scene, set, capture, runs, study, photographs, and the files that commands are given."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.readers import imported, photographs, scenes, text

SCENE = """<scene version="3.0.0">
  <default name="size" value="24"/>
  <sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="$size"/><integer name="height" value="24"/></film></sensor>
  <emitter type="constant"/>
  <shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
    <string name="filename" value="t.png"/></texture></bsdf></shape>
  <shape type="ply"><string name="filename" value="m.ply"/></shape>
</scene>
"""
OVERRIDE = """
[override]
views = 4
width = 24
height = 24
spp = 4
render.variant = "scalar"
"""
STUDY = """
[grid]
scene = "scene.xml"
electrons = 20
method = "quick"
[variant.quick]
method = "naive"
fit.iterations = 5
"""
DATASET = """
[dataset]
name = "dark"
licence = "CC-BY-4.0"
creators = ["me"]
shard_mb = 0.2
[dataset.split]
train = 1
[grid]
scene = ["scene.xml"]
electrons = [20]
"""
VARIANTS = '[variant.quick]\nmethod = "naive"\nfit.iterations = 5\n'
SMALL = ["--views", "4", "--width", "24", "--height", "24", "--spp", "4", "--variant", "scalar"]
SHORT = ["--points", "60", "--iterations", "8", "--denoiser-steps", "2", "--device", "cpu"]
# What makes the folders of the project, in this order.
MADE = [
    ["render", "scene.xml", "--out", "set", *SMALL],
    ["capture", "set", "--out", "capture", "--electrons", "200"],
    ["reconstruct", "capture", "--out", "exp/naive", "--method", "naive", *SHORT],
    ["reconstruct", "capture", "--out", "exp/oracle", "--method", "oracle", *SHORT],
    ["score", "exp"],
]
MAKE_STUDY = ["study", "study.toml", "--out", "study/light", "--workers", "1"]  # for commands that read one


def write_inputs(folder: Path) -> None:
    """Everything that no command makes."""
    scenes.make(folder)
    for name in ("m.obj", "m.serialized", "e.exr"):
        (folder / name).unlink()
    (folder / "scene.xml").write_text(SCENE)
    (folder / "study.toml").write_text(STUDY + OVERRIDE)
    (folder / "data.toml").write_text(DATASET + OVERRIDE)
    (folder / "variants.toml").write_text(VARIANTS)
    imported.make_photographs(folder / "own")
    for name, make in _INPUTS.items():
        (folder / name).mkdir()
        make(folder / name)
    camera = "gain = 1.5\neta = 0.5\nsigma_d = 2.0\nmu_e_sat = 4000\nblack_level = 60\nbits = 12\n"
    (folder / "camera.toml").write_text(camera)


def _renders(folder: Path) -> None:
    from simscenes.sets.pictures.png import write_png

    rng = np.random.default_rng(0)
    for i in range(4):
        write_png(folder / f"{i:04d}.png", rng.integers(0, 255, (24, 24, 3), np.uint8))


def _frames(folder: Path) -> None:
    """Dark and flat stacks of a camera, as many as it takes to characterise one."""
    from sensor_model import PRESETS, Exposure, expose

    sensor, lines = PRESETS["prime-95b"], ["bits = 12", "[camera]", "mu_e_sat = 9000.0", "eta = 0.9"]
    for kind in ("dark", "flat"):
        for i, time in enumerate((0.05, 0.1, 0.2, 0.4, 0.6, 0.8)):
            photons = 2000.0 * time * (kind == "flat")
            (folder / kind / str(i)).mkdir(parents=True)
            lines += [f'[stacks."{kind}/{i}"]', f"time = {time}", f"photons = {photons}"]
            for n in range(2):
                light = np.full((32, 40), photons)
                frame = expose(light, sensor, Exposure(time=time), seed=100 * i + len(kind), view=0, frame=n)
                np.save(folder / kind / str(i) / f"{n}.npy", frame.dn)
    (folder / "frames.toml").write_text("\n".join(lines))


_INPUTS: dict[str, Callable[[Path], object]] = {
    "renders": _renders, "photos": photographs.make_bare, "film": photographs.make_video, "frames": _frames,
    "posed": text.make_transforms,
}  # fmt: skip


def without_costly(folder: Path) -> None:
    """Remove what no command reads, so that the project is small."""
    for name in ("own/sixteen", "study/light/logs"):
        shutil.rmtree(folder / name, ignore_errors=True)
    assert json.loads((folder / "set" / "set.json").read_text())
