"""The pictures in which a source of cameras looks for features: one file a kind."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from sensor_model.files.registry import Registry

# Kind -> (dark pictures [h, w, 3], sRGB-encoded, 0..1; seed of random choices) -> each as uint8 [h, w, 3], in order.
SEEN: Registry[Callable[[Sequence[Any], int], Iterator[Any]]] = Registry(
    {
        "raw": "novags.testbed.stages.seen.raw:pictures",
        "enhanced": "novags.testbed.stages.seen.enhanced:pictures",
        "denoised": "novags.testbed.stages.seen.denoised:pictures",
    }
)
