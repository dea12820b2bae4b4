"""Options of every command, `--allow-links`, `--verify` and `--plugin`; and the folders that its words let links lead
to.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

LINKS, VERIFY, PLUGIN = "--allow-links", "--verify", "--plugin"
VARIABLE = "NOVAGS_VERIFY"  # as `ledger.hashes` reads it, without whose imports --help does
HELP = (
    f"Every command takes {LINKS} FOLDER: links in the folders that it reads may lead there; others are refused. And "
    f"{VERIFY}: every file is read to compare it with its record, even where size and times are those of before. And "
    f"{PLUGIN} FILE: a file of Python with methods, enhancers, cameras, scenes or metrics of yours: `novags new`."
)


def without_common(words: Sequence[str]) -> tuple[list[str], AbstractContextManager[None]]:
    """The words of a command line that are left for its command, and the context to hold while it runs.

    Raises:
        ValueError: If the folder or the file of an option is missing.
    """
    rest, folders, plugins, verify = list[str](), list[str](), list[str](), False
    left = iter(words)
    for word in left:
        option, equals, value = word.partition("=")
        if word == VERIFY:
            verify = True
        elif option == LINKS:
            folders.append(value if equals else next(left, ""))
            if not os.path.isdir(folders[-1]):
                raise ValueError(f"{LINKS} must be followed by a folder that is there, got {folders[-1]!r:.80}")
        elif option == PLUGIN:
            plugins.append(value if equals else next(left, ""))
            if not os.path.isfile(plugins[-1]):
                raise ValueError(f"{PLUGIN} must be followed by a file of Python, got {plugins[-1]!r:.80}")
        else:
            rest.append(word)
    # Not the first, which names the command: a folder called "study" is not meant by it.
    named = [*folders, *rest[1:], *(word.partition("=")[2] for word in rest if word.startswith("-"))]
    if set(rest) & {"-h", "--help"}:
        return rest, nullcontext()
    return rest, _held(named, plugins, verify)


@contextmanager
def _held(named: Sequence[str], plugins: Sequence[str], verify: bool) -> Iterator[None]:
    from sensor_model.files.door import given  # numpy comes with it: --help must not wait for that
    from sensor_model.files.outside import add_file

    before = os.environ.get(VARIABLE)
    if verify:
        os.environ[VARIABLE] = "1"
    try:
        with given([*named, *plugins]):
            for plugin in plugins:
                add_file(Path(plugin))
            yield
    finally:
        if verify and before is None:
            del os.environ[VARIABLE]
