"""The stages: folder in, folder out. `cache.run_stage` makes them resumable and keeps finished work.

`stale` names files elsewhere that describe an earlier result; they are removed together with it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from novags.testbed.stages.capturing import capture as capture
    from novags.testbed.stages.denoising import denoise as denoise
    from novags.testbed.stages.importing import import_photographs as import_photographs
    from novags.testbed.stages.posing import poses as poses
    from novags.testbed.stages.reconstructing import reconstruct as reconstruct
    from novags.testbed.stages.rendering import render as render
    from novags.testbed.stages.scoring import score as score

MODULES = {
    "capture": "capturing", "denoise": "denoising", "import_photographs": "importing", "poses": "posing",
    "reconstruct": "reconstructing", "render": "rendering", "score": "scoring",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """A stage; its module is loaded on first use: rendering needs no torch, whose import takes seconds."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{MODULES[name]}"), name)
