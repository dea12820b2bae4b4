"""The stages, folder in, folder out. What makes them resumable and keeps finished work is `cache.run_stage`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from novags.testbed import capture_folder
from novags.testbed.cache import folder_digest, run_stage
from novags.testbed.capture import CaptureConfig, capture_views
from novags.testbed.console import Console
from novags.testbed.source import open_source


def capture(set_path: Path, out: Path, config: CaptureConfig, console: Console) -> dict[str, Any]:
    """Photograph the set at `set_path` in the dark; returns capture.json.

    Raises:
        ValueError: If the set cannot be read or is black, or `out` holds other things.
    """
    source = open_source(set_path, console, config.max_size)
    set_hash = folder_digest(set_path)
    return run_stage(
        "capture",
        out,
        capture_folder.RECORD,
        inputs={"set": set_hash},
        config=asdict(config),
        owns=capture_folder.OWNS,
        work=lambda: capture_views(source, out, config, console),
        console=console,
    )
