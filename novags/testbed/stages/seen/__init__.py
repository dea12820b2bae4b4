"""The pictures in which a source of cameras looks for features: one file a kind."""

from collections.abc import Callable
from typing import Any

from sensor_model.files.registry import Registry

# Kind -> (dark pictures [C, h, w, 3], sRGB-encoded, 0..1; seed of random choices) -> uint8 [C, h, w, 3].
SEEN: Registry[Callable[[Any, int], Any]] = Registry(
    {
        "raw": "novags.testbed.stages.seen.raw:pictures",
        "enhanced": "novags.testbed.stages.seen.enhanced:pictures",
        "denoised": "novags.testbed.stages.seen.denoised:pictures",
    }
)
