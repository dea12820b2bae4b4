"""WebDataset shards: plain tar files, in which the files of a sample stand together and share the start of their names.

The same samples give the same bytes: names in order, no times, no owners.
"""

import hashlib
import io
import json
import re
import tarfile
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import Any

from novags.testbed.dataset.file import SPLITS
from novags.testbed.dataset.publish import DatasetView
from novags.testbed.ledger.contents import read_json, write_json
from sensor_model.files.atomic import atomic
from sensor_model.files.door import read_bytes

FOLDER, STATE = "shards", ".shards.json"
SHARD = re.compile(rf"({'|'.join(SPLITS)})-\d{{6,}}\.tar")
MEMBERS = {"dark": "dark.png", "dark16": "dark16.png", "raw": "raw.dng", "truth": "truth.exr", "lit": "lit.png",
           "gt": "gt.exr"}  # fmt: skip


def write_shards(views: Sequence[DatasetView], out: Path, megabytes: float, sums: dict[str, str]) -> list[str]:
    """Write the shards that are not there yet; returns their names, relative to the data set.

    Args:
        views: The samples, in order.
        out: The data set.
        megabytes: Size at which a shard is closed, 1e6 bytes.
        sums: SHA-256 of every file of the data set, by its relative name.

    Raises:
        OSError: If the disk is full or may not be written to.
    """
    folder = out / FOLDER
    folder.mkdir(exist_ok=True)
    state_file = folder / STATE
    known = read_json(state_file, {"*": str}) if state_file.exists() else {}
    made: dict[str, str] = {}
    for name, samples in _divided(views, out, megabytes * 1e6):
        recipe = hashlib.sha256("\n".join(_line(*sample, sums) for sample in samples).encode()).hexdigest()
        if known.get(name) != recipe or not (folder / name).is_file():
            with atomic(folder / name) as temporary:
                _write(temporary, samples, out)
        made[name] = recipe
        write_json(state_file, {**known, **made})
    remove_shards(out, but=made)
    write_json(state_file, made)
    return [f"{FOLDER}/{name}" for name in made]


def remove_shards(out: Path, but: Container[str] = ()) -> None:
    """Remove the shards of an earlier file of this data set, which its manifest does not list, except those named.

    Raises:
        OSError: If they cannot be removed.
    """
    folder = out / FOLDER
    for path in sorted(folder.glob("*.tar")):
        if SHARD.fullmatch(path.name) and path.name not in but:
            path.unlink()
    if not but and folder.is_dir():
        (folder / STATE).unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()


def _divided(
    views: Sequence[DatasetView], out: Path, limit: float
) -> Iterator[tuple[str, list[tuple[str, DatasetView]]]]:
    """Shards of each split by name, with their samples by key."""
    captures = {place: number for number, place in enumerate(dict.fromkeys(view.row["capture"] for view in views))}
    for split in dict.fromkeys(view.row["split"] for view in views):
        number, size, samples = 0, 0, list[tuple[str, DatasetView]]()
        for view in (view for view in views if view.row["split"] == split):
            samples.append((f"{captures[view.row['capture']]:06d}-{view.i:05d}", view))
            size += sum((out / view.row[kind]).stat().st_size for kind in MEMBERS)
            if size >= limit:
                yield f"{split}-{number:06d}.tar", samples
                number, size, samples = number + 1, 0, []
        if samples:
            yield f"{split}-{number:06d}.tar", samples


def _line(key: str, view: DatasetView, sums: dict[str, str]) -> str:
    return " ".join([key, *(sums[view.row[kind]] for kind in MEMBERS), json.dumps(about(view), sort_keys=True)])


def _write(path: Path, samples: list[tuple[str, DatasetView]], out: Path) -> None:
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
        for key, view in samples:
            for kind, suffix in MEMBERS.items():
                _add(tar, f"{key}.{suffix}", read_bytes(out / view.row[kind]))
            _add(tar, f"{key}.json", json.dumps(about(view), sort_keys=True).encode())


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = len(content), 0o644  # it begins with time 0 and owner 0
    tar.addfile(member, io.BytesIO(content))


def about(view: DatasetView) -> dict[str, Any]:
    """The text of a sample beside its pictures: its row without paths, and its camera."""
    rig = view.cameras.rig
    kept = {name: value for name, value in view.row.items() if name not in MEMBERS}
    return {**kept, "viewmat": rig.viewmats[view.i].tolist(), "K": rig.Ks[view.i].tolist(), "width": rig.width,
            "height": rig.height}  # fmt: skip
