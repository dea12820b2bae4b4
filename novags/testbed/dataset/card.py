"""The data card: README.md of a data set, with the head that Hugging Face reads."""

import json
import re
from collections.abc import Collection, Sequence
from typing import Any

from novags.testbed.dataset.file import SPLITS, DatasetConfig
from novags.testbed.dataset.publish import METADATA, DatasetEntry
from novags.testbed.dataset.recipes.listed import RECIPES
from novags.testbed.dataset.recipes.snr import FORMULA
from simscenes.loading.reference import is_scene_file

TASKS = ["image-to-image", "image-to-3d", "depth-estimation"]  # as the hub spells them
SPDX = re.compile(r"[A-Za-z0-9.+-]+")
# Textures of scene files may be photographs.
CATALOGUE_ONLY = "Everything is rendered: no photograph is part of it, and nothing shows a real place or person."
# Simulated effects are switched on by the plans; no scene and no camera here has these.
NEVER = (
    "Scenes stand still; nothing moves between two views.",
    "Noise follows the camera models named above; compression, sharpening and denoising in a camera are not simulated "
    "unless `capture.jpeg_quality` is among the settings.",
    "Cameras are known exactly, and lenses have no distortion.",
)


def card(config: DatasetConfig, entries: Sequence[DatasetEntry], manifest: dict[str, Any]) -> str:
    """The text of README.md."""
    captures = [entry for entry in entries if entry.task.kind == "capture"]
    views = sum(entry.record["views"] for entry in captures)
    tags = ["low-light", "novel-view-synthesis", "denoising", "synthetic"]
    head = {**_licence(config.licence), "pretty_name": config.name, "task_categories": TASKS, "tags": tags,
            "size_categories": [_size(views)], "configs": _configs({entry.split for entry in captures})}  # fmt: skip
    lines = ["---", *(f"{key}: {json.dumps(value)}" for key, value in head.items()), "---", "", f"# {config.name}", ""]
    lines += [config.description or "Views of rendered scenes, photographed in the dark by simulated cameras.", ""]
    lines += [f"Version {config.version}, licence {config.licence}." + _by(config), "", "| split | scenes | captures | "
              "views |", "| --- | --- | ---: | ---: |"]  # fmt: skip
    for split in SPLITS:
        own = [entry for entry in captures if entry.split == split]
        scenes = list(dict.fromkeys(entry.scene for entry in own))
        if own:
            lines.append(f"| {split} | {_some(scenes)} | {len(own)} | {sum(c.record['views'] for c in own)} |")
    together = "scene with all its variations" if config.split_by == "scene" else "variation of a scene"
    lines += ["", f"No {together} lies in two splits.", "", "## Contents", "", *_LAYOUT, ""]
    if config.recipes:
        lines += [*(f"- `training/{name}`: {RECIPES[name].what}." for name in config.recipes), "", f"{FORMULA}.", ""]
    lines += ["## How it was made", "", f"By novags {manifest['software']['novags']}: scenes rendered by Mitsuba "
              f"{manifest['software']['mitsuba']}, then exposed by a model of each camera. "
              "No two captures share the random numbers of noise (`noise_seed` in `index.csv`); the fixed pattern "
              "is the camera's, the same in all its captures.", ""]  # fmt: skip
    lines += ["| | values |", "| --- | --- |"]
    for name in captures[0].values if captures else ():  # the axes of the file, which all have
        lines.append(f"| {name} | {_some([str(v) for v in dict.fromkeys(e.values[name] for e in captures)])} |")
    lines += [f"| seeds | {_some([str(s) for s in manifest['seeds']])} |", ""]
    lines += ["Simulated, and left out because the scene or the camera has none or it would not show:", "", *_effects(
        entries), ""]  # fmt: skip
    cost = manifest["cost"]
    lines += [f"It took {cost['seconds']:.0f} s of work and holds {cost['bytes'] / 1e6:.1f} MB. `manifest.json` has "
              "the effects that every set and capture simulates or leaves out, with reasons and bounds, its cost, and "
              "the SHA-256 of every file.", "", "## Not in it", ""]  # fmt: skip
    never = NEVER if any(is_scene_file(entry.scene) for entry in entries) else (CATALOGUE_ONLY, *NEVER)
    return "\n".join([*lines, *(f"- {text}" for text in never), ""])


def _licence(licence: str) -> dict[str, str]:
    """As the hub names it: an SPDX identifier in small letters, or "other" with the text."""
    if SPDX.fullmatch(licence):
        return {"license": licence.lower()}
    return {"license": "other", "license_name": licence}


def _configs(splits: Collection[str]) -> list[dict[str, Any]]:
    """The files that load_dataset of the package datasets reads: rows and 8-bit pictures of each split.

    Shards are not among them: all configurations of a folder have one format, which datasets takes from the first.
    """
    files = [{"split": split, "path": [f"{split}/{METADATA}", f"{split}/*/*/images/*.png"]}
             for split in SPLITS if split in splits]  # fmt: skip
    return [{"config_name": "views", "default": True, "data_files": files}]


_LAYOUT = (
    "| | |",
    "| --- | --- |",
    "| `index.csv` | a row for each view, with the paths below |",
    "| `SPLIT/metadata.jsonl` | the same rows, for `datasets.load_dataset`, which opens the 8-bit pictures with them |",
    "| `SPLIT/capture/NAME/images`, `images16`, `raw` | dark pictures: 8-bit sRGB, 16-bit linear, DNG |",
    "| `SPLIT/capture/NAME/truth` | EXR: mean, variance and noise-free digital numbers of each pixel |",
    "| `SPLIT/set/NAME/images`, `gt` | in good light: 8-bit sRGB; EXR with radiance, depth, normals, albedo, ids |",
    "| `transforms.json`, `sparse/0`, lists of train, val, test views | cameras, for nerfstudio and COLMAP readers |",
    "| `shards` | the same views as WebDataset tar files, if they were asked for; of `dark16.png` decoders that use "
    "Pillow keep 8 bits |",
    "| `training/RECIPE` | what networks train on, if it was asked for, in .npz files that its index.csv lists |",
    "| `manifest.json`, `croissant.json` | everything about it; metadata for search and loading |",
)


def _effects(entries: Sequence[DatasetEntry]) -> list[str]:
    rows = ["| | in | left out somewhere |", "| --- | --- | --- |"]
    for kind, what in (("set", "light"), ("capture", "camera")):
        plans = [entry.facts()["simulation"] for entry in entries if entry.task.kind == kind]
        on = dict.fromkeys(name for plan in plans if plan["on"] != "all" for name in plan["on"])
        off = dict.fromkeys(name for plan in plans for name in plan["off"])
        all_on = all(plan["on"] == "all" for plan in plans)
        rows.append(f"| {what} | {'all effects' if all_on else ', '.join(on)} | {', '.join(off) or 'none'} |")
    return rows


def _by(config: DatasetConfig) -> str:
    return f" By {', '.join(config.creators)}." if config.creators else ""


def _some(names: Sequence[str], count: int = 12) -> str:
    return ", ".join(names[:count]) + (f" and {len(names) - count} more" if len(names) > count else "")


def _size(count: int) -> str:
    bounds = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
    return next((name for bound, name in bounds if count < bound), "1M<n<10M")
