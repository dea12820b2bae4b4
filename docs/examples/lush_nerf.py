"""LuSh-NeRF (github.com/quzefan/LuSh-NeRF, MIT) as a method of a study, see lush-nerf.toml: hand it a capture in its
layout, train it, and collect its pictures of the test views.

Its program needs an NVIDIA GPU, an environment of its own (--python) and GIM's weights, as its README says.
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from simscenes import export_llff, load_set

HELD_OUT = 8  # every eighth view, from the first: its llffhold

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--repo", type=Path, required=True, help="a clone of it")
parser.add_argument("--capture", type=Path, required=True)
parser.add_argument("--out", type=Path, required=True)
parser.add_argument("--python", default=sys.executable, help="of its environment")
parser.add_argument("--iterations", default="100000", help="as published")
options = parser.parse_args()

views = load_set(options.capture)
if views.test_indices != list(range(0, len(views), HELD_OUT)):
    sys.exit(f"LuSh-NeRF holds out every {HELD_OUT}th view, this capture {views.test_indices}")
with TemporaryDirectory() as work:
    data, logs = Path(work) / "data", Path(work) / "logs"
    export_llff(views, data)
    shutil.copytree(data / "images", data / "images_1")  # where it looks for pictures at `factor = 1`
    command = [options.python, "run_lushnerf.py", "--config", "configs/poster_lushnerf", "--datadir", data, "--basedir",
               logs, "--tbdir", logs / "tb", "--expname", "capture", "--N_iters", options.iterations,
               "--no_ndc"]  # fmt: skip
    subprocess.run(command, cwd=options.repo, check=True)
    subprocess.run([*command, "--render_only", "--render_test"], cwd=options.repo, check=True)
    (rendered,) = (logs / "capture").glob("renderonly_test_*")
    for i in views.test_indices:
        shutil.copyfile(rendered / f"{i:03d}.png", options.out / f"{views.names[i]}.png")
