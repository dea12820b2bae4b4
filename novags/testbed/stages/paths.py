"""Where a stage may write."""

from pathlib import Path


def keep_apart(out: Path, source: Path) -> None:
    """Refuse an output inside an input: it would change the input's hash, and the stage would never count as done.

    Raises:
        ValueError: If `out` lies inside `source`.
    """
    if out.resolve().is_relative_to(source.resolve()):
        raise ValueError(f"the output {out} must not lie inside its input {source}: choose another --out")
