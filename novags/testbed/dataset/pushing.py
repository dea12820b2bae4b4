"""Send a finished data set to the Hugging Face hub."""

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.dataset.make import MANIFEST
from novags.testbed.ledger.contents import read_json
from sensor_model.files.reading import brief, some

PLACE = re.compile(r"hf:([A-Za-z0-9][A-Za-z0-9._-]*/[A-Za-z0-9][A-Za-z0-9._-]*)")
NOT_SENT = ("making", "making/**", ".*", ".*/**", "*/.*")  # tables and logs of the work, locks
WRITTEN: Any = {"files": {"*": {"bytes": int}}}


def repository(place: str) -> str:
    """The repository that `hf:OWNER/NAME` names.

    Raises:
        ValueError: If it names none.
    """
    if (found := PLACE.fullmatch(place)) is None:
        raise ValueError(f"--push takes hf:OWNER/NAME of the Hugging Face hub, got {brief(repr(place), 100)}")
    return found[1]


def push(out: Path, place: str, console: Console) -> str:
    """Send a data set as one commit of a private repository, if there is a token; in words what was done.

    The token is the hub's own: HF_TOKEN, or `hf auth login`. Without one nothing is sent.

    Args:
        out: Folder of a finished data set.
        place: `hf:OWNER/NAME`.
        console: Where notes go.

    Raises:
        ValueError: If a file of the data set is missing or has another size, or the hub's package is not installed.
    """
    name = repository(place)
    files = read_json(out / MANIFEST, WRITTEN)["files"]
    if wrong := [file for file, told in files.items() if not _is_whole(out / file, told["bytes"])]:
        raise ValueError(f"{len(wrong)} files of {out} are not as its {MANIFEST} says: {some(wrong)}; make the data "
                         "set again")  # fmt: skip
    size, url = sum(told["bytes"] for told in files.values()), f"https://huggingface.co/datasets/{name}"
    ready = f"{len(files) + 1} files, {size / 1e6:.1f} MB"
    if find_spec("huggingface_hub") is None:
        raise ValueError(f"--push needs the hub's package: pip install 'novags[hub]'; {ready} are ready for {url}")
    import huggingface_hub

    if (token := huggingface_hub.get_token()) is None:
        return f"{ready} are ready for {url}; nothing was sent, for there is no token: set HF_TOKEN, or hf auth login"
    console.note(f"push: {ready} to {url}")
    hub = huggingface_hub.HfApi(token=token)
    hub.create_repo(name, repo_type="dataset", private=True, exist_ok=True)
    hub.upload_folder(repo_id=name, folder_path=str(out), repo_type="dataset", ignore_patterns=list(NOT_SENT),
                      commit_message=f"The data set that {MANIFEST} describes")  # fmt: skip
    return f"{url}: {ready} were sent; a repository that is new is private"


def _is_whole(file: Path, size: int) -> bool:
    return file.is_file() and file.stat().st_size == size
