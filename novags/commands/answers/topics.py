"""Help pages about terms, as text files beside this one."""

from difflib import get_close_matches
from importlib.resources import files


def topics() -> tuple[str, ...]:
    """The terms that have a page."""
    return tuple(sorted(f.name.removesuffix(".txt") for f in _folder().iterdir() if f.name.endswith(".txt")))


def page(topic: str) -> str:
    """The page about a term.

    Raises:
        ValueError: If there is no such page.
    """
    if topic not in topics():
        near = get_close_matches(topic, topics(), 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"no page about {topic!r}; {hint}available: {', '.join(topics())}")
    return (_folder() / f"{topic}.txt").read_text(encoding="utf-8").rstrip()


def _folder():  # type: ignore[no-untyped-def]  # importlib's Traversable moved between Python versions
    return files("novags.commands.answers")
