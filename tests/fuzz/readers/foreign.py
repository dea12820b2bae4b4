"""Pictures of other programs, programs as methods, and the file of a data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz.case import Reader

SIZE = (18, 24)


def make_renders(folder: Path) -> None:
    from simscenes.sets.pictures.exr import write_exr
    from simscenes.sets.pictures.png import write_png

    rng = np.random.default_rng(0)
    write_png(folder / "eight.png", rng.integers(0, 255, (*SIZE, 3), dtype=np.uint8))
    write_png(folder / "sixteen.png", rng.integers(0, 65535, (*SIZE, 3), dtype=np.uint16))
    write_png(folder / "alpha.png", rng.integers(0, 65535, (*SIZE, 4), dtype=np.uint16))
    planes = {name: rng.random(SIZE).astype(np.float32) for name in ("R", "G", "B", "Z", "alpha")}
    write_exr(folder / "depth.exr", planes)


def read_renders(folder: Path, file: Path) -> object:
    """As `novags score --renders` does."""
    from novags.testbed.importing.pictures import find_renders, read_picture

    found = find_renders(folder, ["eight", "sixteen", "alpha", "depth"]).files
    return {name: read_picture(path, SIZE[1], SIZE[0]) for name, path in found.items()}


def make_files(folder: Path) -> None:
    (folder / "mine.py").write_text("pass")
    (folder / "study.toml").write_text(
        '[grid]\nmethod = ["naive", "mine"]\nelectrons = [5, 20]\n[method.mine]\n'
        'command = "python3 mine.py --in {capture} --out {out} --seed {seed}"\ntimeout = 60\nspace = "linear"\n'
        'files = ["mine.py"]\ntitle = "mine"\n'
    )
    (folder / "data.toml").write_text(
        '[dataset]\nname = "dark"\nlicence = "CC-BY-4.0"\ncreators = ["me"]\ndate = 2026-01-31\nshard_mb = 1.5\n'
        'split_by = "variation"\nseed = 3\n[dataset.split]\ntrain = 0.7\nval = 0.3\ntest = ["cornell"]\n[grid]\n'
        'scene = ["tabletop:0..5", "cornell"]\nrig = ["near"]\nelectrons = [2, 5]\n[rig.near]\nviews = 5\n'
    )


def read_file(folder: Path, file: Path) -> object:
    from novags.testbed.dataset.file import read_dataset
    from novags.testbed.dataset.make import splits
    from novags.testbed.study.cells.grid import read_study

    if file.name == "data.toml":
        found = read_dataset(file)
        return found, splits(*found)
    return read_study(file)


def _pictures() -> None:
    import cv2
    import OpenEXR  # noqa: F401
    import PIL.Image  # noqa: F401

    import novags.testbed.importing.pictures  # noqa: F401

    cv2.setNumThreads(0)


def _files() -> None:
    import novags.testbed.dataset.make  # noqa: F401


READERS = [
    Reader("pictures of a program", make_renders, read_renders, ("*.png", "*.exr"), share=1, prepare=_pictures),
    Reader("TOML: a study and a data set", make_files, read_file, ("*.toml",), share=1, prepare=_files),
]
