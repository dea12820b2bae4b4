"""Example files of programs as methods: what they hand to a program is what it asks for; its pictures are scored.

The programs themselves need a GPU and are not here. Stand-ins have their options and files, and refuse all others.
"""

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.stages.command import run_command
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.command import CommandConfig, read_commands
from sensor_model.files.toml_file import read_toml
from simscenes import default_rig, load_set, render_set
from simscenes.sets.pictures.png import read_png

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
QUIET = Console(quiet=True)
# Options, files and places of pictures as in run_lushnerf.py and data_utils/load_llff.py, read on 2026-11-30.
LUSH_NERF = """
import argparse
from pathlib import Path
import numpy as np
from PIL import Image
parser = argparse.ArgumentParser(allow_abbrev=False)
for name in ("config", "datadir", "basedir", "tbdir", "expname"):
    parser.add_argument(f"--{name}", required=True)
parser.add_argument("--N_iters", type=int)
for name in ("no_ndc", "render_only", "render_test"):
    parser.add_argument(f"--{name}", action="store_true")
options = parser.parse_args()
assert Path(options.config).is_file() and options.no_ndc
place = Path(options.basedir) / options.expname
files = sorted((Path(options.datadir) / "images_1").iterdir())
poses = np.load(Path(options.datadir) / "poses_bounds.npy")
assert poses.shape == (len(files), 17) and (0 < poses[:, 15]).all() and (poses[:, 15] < poses[:, 16]).all()
if not options.render_only:
    place.mkdir(parents=True)
    (place / f"{options.N_iters:06d}.tar").touch()
else:
    (weights,) = place.glob("*.tar")
    (out := place / f"renderonly_{'test' if options.render_test else 'path'}_{weights.stem}").mkdir()
    for i, file in enumerate(files):
        Image.fromarray(255 - np.asarray(Image.open(file))).save(out / f"{i:03d}.png")
        Image.new("L", (4, 4)).save(out / f"{i:03d}_disp.png")
"""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("of")
    render_set("cornell", default_rig("cornell", 9, 32, 32), folder / "set", spp=2)
    stages.capture(folder / "set", folder / "capture", CaptureConfig(electrons=200.0), QUIET)
    return folder / "capture"


@pytest.fixture
def lush_nerf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CommandConfig:
    for name in ("lush-nerf.toml", "lush_nerf.py"):
        shutil.copyfile(EXAMPLES / name, tmp_path / name)
    (tmp_path / "LuSh-NeRF" / "configs").mkdir(parents=True)
    (tmp_path / "LuSh-NeRF" / "configs" / "poster_lushnerf").touch()
    (tmp_path / "LuSh-NeRF" / "run_lushnerf.py").write_text(LUSH_NERF)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parents[1]))
    (found,) = read_commands(read_toml(tmp_path / "lush-nerf.toml")["method"], tmp_path)
    return found


def test_lush_nerf_gets_its_layout_and_gives_a_picture_of_each_test_view(
    lush_nerf: CommandConfig, capture: Path, tmp_path: Path
) -> None:
    record = run_command(capture, tmp_path / "run", lush_nerf, QUIET)
    assert record["name"] == "lush-nerf"
    names = load_set(capture).names
    shown = sorted((tmp_path / "run" / "renders").iterdir())
    assert [file.stem for file in shown] == [names[0], names[8]]
    for file in shown:
        dark = read_png(capture / "images" / file.name)
        np.testing.assert_allclose(read_png(file), 1 - dark, atol=1e-6)
    run = tmp_path / "run"
    assert stages.score(run, QUIET)["methods"]["lush-nerf"]["mean"]["lit"]["psnr"] > 0


def test_lush_nerf_refuses_a_capture_whose_test_views_are_others(
    lush_nerf: CommandConfig, capture: Path, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(capture.parent, tmp_path / "of")) / "capture"
    script = (tmp_path / "lush_nerf.py").read_text()
    (tmp_path / "lush_nerf.py").write_text(script.replace("HELD_OUT = 8", "HELD_OUT = 4"))
    with pytest.raises(ValueError, match=r"LuSh-NeRF holds out every 4th view, this capture \[0, 8\]"):
        run_command(other, tmp_path / "run", lush_nerf, QUIET)
