"""A recipe: samples that a network trains on, from captures that differ in their light alone.

Symbols: `h, w` are sides of a picture, `L` is the number of light levels, from the darkest to the brightest.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from novags.testbed.dataset.recipes.snr import snr_db
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.ledger.contents import digest
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.study.cells.presets import Preset
from sensor_model.params import Sensor
from simscenes.sets.multiview import MultiviewSet, load_set

OWN = ("electrons", "drawn")  # settings that differ in a group: the light, and the seed of the noise


@dataclass(frozen=True)
class Level:
    """A capture of a data set, opened."""

    capture: Capture

    @property
    def electrons(self) -> float:
        """Mean signal of green, e-."""
        assert self.capture.record.simulated is not None  # a data set is of rendered scenes
        return self.capture.record.simulated.electrons

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        assert self.capture.sensor is not None
        return self.capture.sensor

    @cached_property
    def snr_db(self) -> float:
        """Signal over noise of all views, dB: `snr.snr_db`."""
        return snr_db(self.capture)


@dataclass(frozen=True)
class Group:
    """Captures of one set by one camera, from the darkest to the brightest.

    Attributes:
        levels: The captures.
        views: The set in good light.
    """

    levels: tuple[Level, ...]
    views: MultiviewSet

    @property
    def names(self) -> tuple[str, ...]:
        """Of the views."""
        return self.views.names


@dataclass(frozen=True)
class Sample:
    """One file of arrays.

    Attributes:
        name: Of the file without its ending, which no other sample of the group has.
        row: Of the recipe's index beside split, scene and file.
        arrays: The content by name.
    """

    name: str
    row: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Recipe:
    """What a network of one kind trains on.

    Attributes:
        what: In a line of the data card.
        check: Refuses captures of one group that it cannot be made of, with a ValueError; before any work.
        pixel_bytes: Bytes that a pixel of a view takes in the files of a group.
        samples: All samples of a group.
    """

    what: str
    check: Callable[[Sequence[Preset]], None]
    pixel_bytes: Callable[[Sequence[Preset]], float]
    samples: Callable[[Group], Iterator[Sample]]

    @property
    def module(self) -> str:
        """Where it is written: the samples depend on this code."""
        return self.samples.__module__


def group_key(of_set: Any, capture: CaptureConfig) -> str:
    """The same for captures of one set that differ in their light and its noise alone.

    Args:
        of_set: What tells the set from others.
        capture: Of the capture.
    """
    kept = {name: value for name, value in capture.resolved().items() if name not in OWN}
    return digest([of_set, kept])


def groups_of(presets: Iterable[Preset]) -> list[list[Preset]]:
    """Captures before they are made, as `Group` has them."""
    found: dict[str, list[Preset]] = {}
    for preset in presets:
        found.setdefault(group_key(preset.render.resolved(), preset.capture), []).append(preset)
    return list(found.values())


def opened_group(captures: Sequence[Path], lit: Path) -> Group:
    """Open folders of captures and of their set as a group.

    Raises:
        ValueError: If a folder is damaged.
    """
    levels = sorted((Level(open_capture(path)) for path in captures), key=lambda level: level.electrons)
    return Group(tuple(levels), load_set(lit))
