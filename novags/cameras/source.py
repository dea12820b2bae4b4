"""One source of cameras: its row in the table `SOURCES`, and the base of every configuration."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from novags.cameras.settings import Pictures

if TYPE_CHECKING:
    from novags.cameras.estimate import CameraEstimate

Progress = Callable[[int, int, str], None]
"""Steps done, total steps, and the current activity."""


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """The configuration of a source; each source derives its own, whose fields are its settings."""

    @property
    def looks_at(self) -> Pictures:
        """Which pictures the source wants to see: its setting `pictures`; "raw" of one without it."""
        found: Pictures = getattr(self, "pictures", "raw")
        return found

    @property
    def keeps_cameras(self) -> bool:
        """Whether the estimate has the set's own cameras, told to a network that gives the first points alone."""
        return getattr(self, "known", "nothing") == "cameras"


@dataclass(frozen=True)
class CameraSource:
    """A row of `novags.cameras.SOURCES`.

    Attributes:
        description: One line.
        config: The class of its configurations.
        check: Raises a ValueError that says what to install or to give if the source cannot run with a configuration.
        estimate: Makes cameras and points of the input named by `takes` and the dark images; its other arguments are
            n_points, config, seed, and a progress or a device.
        takes: Its input: the whole set; the pictures with their intrinsics, "numbered" with `indices` too, their places
            among all views of the set, for cameras that are known by the order of the pictures; with the set's cameras,
            for networks that can be told of them; or the pictures alone.
    """

    description: str
    config: type[CameraConfig]
    check: Callable[[Any], None]
    estimate: Callable[..., "CameraEstimate"]
    takes: Literal["set", "numbered pictures and lenses", "pictures and lenses", "pictures and cameras", "pictures"]
