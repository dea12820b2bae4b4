"""A store at a URL that fsspec knows (s3://, gs://, sftp://, file://, ...), laid out as one on a disk.

An entry is there when its seal is, which is written last. Every fetched file is compared with the checksums of the
seal, so that two studies that send the same entry at once, or a transfer that broke, cost a repetition at most.
"""

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from novags.testbed.ledger.store import SEAL, Seal, clear, damaged, files_of, read_seal
from novags.testbed.study.entry import Task
from sensor_model.files.atomic import atomic

AT_ONCE = 16  # files in transfer at a time
FETCHED = ".fetched.json"  # the seal of an entry whose files are not all there yet


class Damaged(ValueError):
    """An entry at a URL has changed since it was sealed."""


@dataclass(frozen=True)
class Remote:
    """A store at a URL.

    Raises:
        ValueError: If fsspec is not installed, or knows no such URL.
    """

    url: str

    def __post_init__(self) -> None:
        _ = self._place

    @property
    def _place(self) -> tuple[Any, str]:
        """The file system, which fsspec keeps open, and the path on it."""
        try:
            from fsspec.core import url_to_fs

            fs, root = url_to_fs(self.url)
        except (ImportError, ValueError) as error:  # of a package for that protocol, too
            raise ValueError(f"store {self.url}: {error}: pip install 'novags[cluster]' brings fsspec; further "
                             "packages serve s3:// (s3fs), gs:// (gcsfs), ...") from error  # fmt: skip
        return fs, root.rstrip("/")

    def names(self, kind: str) -> set[str]:
        """The folders of a kind, whether their entries are complete or not."""
        fs, root = self._place
        try:
            return {PurePosixPath(str(path)).name for path in fs.ls(f"{root}/{kind}", detail=False, refresh=True)}
        except FileNotFoundError:
            return set()

    def read(self, task: Task, name: str) -> bytes | None:
        """A file of an entry; None if it is not there."""
        fs, root = self._place
        try:
            return bytes(fs.cat_file(_path(root, task, name)))
        except FileNotFoundError:
            return None

    def seal(self, task: Task, folder: Path) -> Seal | None:
        """The seal of an entry; None if the entry is not complete.

        Args:
            task: The entry.
            folder: Where its seal is put, under the name `FETCHED`: its files are not there yet.

        Raises:
            Damaged: If the seal cannot be read, or belongs to another entry.
        """
        content = self.read(task, SEAL)
        if content is None:
            return None
        folder.mkdir(parents=True, exist_ok=True)
        with atomic(folder / FETCHED) as temporary:
            temporary.write_bytes(content)
        try:
            seal = read_seal(folder, FETCHED)
        except ValueError as error:
            raise Damaged(f"{self.url}/{task.kind}/{task.name}: {error}") from error
        assert seal is not None
        if seal.key != task.key or any("/" in name for name in seal.records):
            raise Damaged(f"{self.url}/{task.kind}/{task.name}: its seal belongs to another entry")
        return seal

    def fetch(self, task: Task, folder: Path) -> Seal | None:
        """Bring an entry into a folder, which the caller has locked; right files that are there are kept.

        Returns:
            Its seal, which is in the folder then; None if the entry is not complete. Nothing half fetched stays.

        Raises:
            Damaged: If files are missing or have changed since they were sealed; the folder is empty then.
        """
        try:
            seal = self.seal(task, folder)
            if seal is not None:
                self._complete(task, folder, seal)
                (folder / FETCHED).replace(folder / SEAL)
                return seal
        except ValueError as error:
            clear(folder)
            (folder / FETCHED).unlink()
            raise Damaged(f"{self.url}/{task.kind}/{task.name}: {error}") from error
        if (folder / FETCHED).exists():  # a process that was fetching it has been killed, and now it is gone
            clear(folder)
            (folder / FETCHED).unlink()
        return None

    def _complete(self, task: Task, folder: Path, seal: Seal) -> None:
        (folder / SEAL).unlink(missing_ok=True)
        for _ in range(2):  # the records, then the files that they list
            missing = damaged(folder, seal)
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(lambda name: self._get(task, name, folder / name), missing))
        if wrong := damaged(folder, seal):
            raise ValueError(f"{', '.join(wrong[:3])} not as written (checksum)")

    def _get(self, task: Task, name: str, path: Path) -> None:
        fs, root = self._place
        try:
            with atomic(path) as temporary:
                fs.get_file(_path(root, task, name), str(temporary))
        except FileNotFoundError:
            path.unlink(missing_ok=True)  # the file there is wrong

    def send(self, task: Task, folder: Path, seal: Seal) -> None:
        """Put a complete entry there; the seal goes last, and an earlier one comes off first."""
        fs, root = self._place
        with suppress(FileNotFoundError):
            fs.rm_file(_path(root, task, SEAL))
        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(
                pool.map(lambda name: self._put(folder / name, _path(root, task, name)), files_of(folder, seal.records))
            )
        self._put(folder / SEAL, _path(root, task, SEAL))

    def _put(self, path: Path, target: str) -> None:
        fs, _ = self._place
        fs.makedirs(target.rpartition("/")[0], exist_ok=True)
        fs.put_file(str(path), target)


def _path(root: str, task: Task, name: str) -> str:
    return f"{root}/{task.kind}/{task.name}/{name}"
