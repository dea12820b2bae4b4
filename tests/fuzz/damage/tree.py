"""A folder of files held in memory, and put back as it was, whatever has become of it."""

from __future__ import annotations

import shutil
import stat
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Tree:
    """Contents of regular files, by path relative to the folder, and all folders."""

    files: dict[str, bytes]
    folders: tuple[str, ...]

    @staticmethod
    def of(folder: Path) -> Tree:
        """What is in a folder that is valid: files and folders alone."""
        paths = sorted(folder.rglob("*"))
        files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths if path.is_file()}
        return Tree(files, tuple(path.relative_to(folder).as_posix() for path in paths if path.is_dir()))

    def restore(self, folder: Path) -> None:
        """Make the folder this one again; nothing that stands there is opened or followed."""
        remove(folder)
        folder.mkdir(parents=True)
        for name in self.folders:
            (folder / name).mkdir()
        for name, content in self.files.items():
            (folder / name).write_bytes(content)


def remove(path: Path) -> None:
    """Remove whatever stands there, if anything: a link and not its target, a FIFO without opening it."""
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return
    if stat.S_ISDIR(mode):
        shutil.rmtree(path)
    else:
        path.unlink()
