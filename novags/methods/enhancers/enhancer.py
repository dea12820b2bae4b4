"""One enhancer: its row in the table `ENHANCERS`, and the base of every configuration."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

NETWORK = "enhancer.safetensors"  # beside a saved scene: the weights of the network that enhanced its pictures


@dataclass(frozen=True, kw_only=True)
class EnhancerConfig:
    """Base of the configuration of every enhancer."""


@dataclass(frozen=True)
class Enhancer:
    """An enhancement by name.

    Attributes:
        config: Its configuration, an `EnhancerConfig`, or NoneType.
        enhance: (dark [H, W, 3] sRGB-encoded in 0..1, config, params or None, variance of the linear pictures or None)
            -> enhanced [H, W, 3] and params. With the params of the noisy picture, its noise-free twin goes through the
            very same enhancement.
        typical: (params of several views) -> the params in their middle, for a picture that has no noisy twin.
        network: () -> the `networks.Kind` behind it, if it is a network.
        title: Its work, in a few words.
        settled: (pictures, config) -> the config with the numbers that all pictures of a scene share, where it asks for
            these; None: pictures share nothing.
    """

    config: type
    enhance: Callable[..., Any]
    typical: Callable[..., Any]
    network: Callable[[], Any] | None = None
    title: str = field(kw_only=True)
    settled: Callable[..., Any] | None = field(default=None, kw_only=True)


def stamps(config: Any) -> tuple[tuple[int, ...], ...]:
    """A digest that changes with the files of weights that a configuration names; beside it in keys of results."""
    return tuple(_stamp(path) for path in getattr(config, "weights", None) or ())


def _stamp(path: Path) -> tuple[int, ...]:
    if not path.is_file():
        return ()
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_ctime_ns, stat.st_size, stat.st_ino
