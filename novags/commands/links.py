"""`--allow-links FOLDER` of every command, and what else of a command line says where links may lead."""

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext

OPTION = "--allow-links"
HELP = f"Every command takes {OPTION} FOLDER: links in the folders that it reads may lead there; others are refused."


def without_links(words: Sequence[str]) -> tuple[list[str], AbstractContextManager[None]]:
    """The words of a command line that are left for its command, and what is to be held while it runs.

    Raises:
        ValueError: If the option's folder is missing.
    """
    rest, folders = list[str](), list[str]()
    left = iter(words)
    for word in left:
        option, equals, value = word.partition("=")
        if option != OPTION:
            rest.append(word)
            continue
        folders.append(value if equals else next(left, ""))
        if not os.path.isdir(folders[-1]):
            raise ValueError(f"{OPTION} must be followed by a folder that is there, got {folders[-1]!r:.80}")
    # Not the first, which names the command: a folder called "study" is not meant by it.
    named = [*folders, *rest[1:], *(word.partition("=")[2] for word in rest if word.startswith("-"))]
    if set(rest) & {"-h", "--help"}:
        return rest, nullcontext()
    from sensor_model.files.door import given  # numpy comes with it: --help must not wait for that

    return rest, given(named)
