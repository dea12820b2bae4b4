"""Where a stage may write."""

from pathlib import Path

from sensor_model.files.door import resolved


def keep_apart(out: Path, source: Path) -> None:
    """Refuse an output inside an input: it would change the input's hash, and the stage would never count as done.

    Raises:
        ValueError: If `out` lies inside `source`.
    """
    if resolved(out).is_relative_to(resolved(source)):
        raise ValueError(f"the output {out} must not lie inside its input {source}: choose another --out")
