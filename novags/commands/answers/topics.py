"""Help pages about terms, as text files beside this one."""

from importlib.resources import files

from sensor_model.files.reading import meant


def topics() -> tuple[str, ...]:
    """The terms that have a page."""
    return tuple(sorted(f.name.removesuffix(".txt") for f in _folder().iterdir() if f.name.endswith(".txt")))


def page(topic: str) -> str:
    """The page about a term.

    Raises:
        ValueError: If there is no such page.
    """
    if topic not in topics():
        raise ValueError(f"no page about {topic!r}; {meant(topic, topics())}available: {', '.join(topics())}")
    return (_folder() / f"{topic}.txt").read_text(encoding="utf-8").rstrip()


def _folder():  # type: ignore[no-untyped-def]  # importlib's Traversable moved between Python versions
    return files("novags.commands.answers")
