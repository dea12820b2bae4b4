"""Light levels shaped after the data sets of the NOVA-GS paper: a camera, its light, and which pictures it delivers.

The paper says in words and histograms how dark and how noisy its data sets are, and which have 16 bits; it names
neither cameras nor electrons. `source` is its words, the rest is chosen to fit them.
"""

from dataclasses import dataclass
from typing import Any

from novags.methods.inputs import Pictures
from sensor_model.files.reading import brief, meant
from sensor_model.presets import PRESETS

CHIPS = "-3chip"  # ends the name of a camera, and of a level, without a colour filter array


@dataclass(frozen=True, kw_only=True)
class LightLevel:
    """One light level.

    Attributes:
        sensor: Name of a camera of `sensor_model.PRESETS`.
        electrons: Mean signal of the green channel over the set, e- per pixel and exposure.
        pictures: The pictures for methods that can take either: 8-bit sRGB, or linear 16-bit.
        title: Its meaning, in a sentence.
        source: The paper's words on the data set.
    """

    sensor: str
    electrons: float
    pictures: Pictures
    title: str
    source: str

    def settings(self) -> dict[str, Any]:
        """As `presets.adapted` takes them."""
        return {"sensor": self.sensor, "electrons": self.electrons, "pictures": self.pictures}


_MOSAIC = (
    LightLevel(
        sensor="a7s2-iso1600", electrons=150.0, pictures="8bit",
        title="as LOM: moderately low light, little noise",
        source="LOM corresponds to moderately low-light scenes",
    ),
    LightLevel(
        sensor="imx686-iso800", electrons=12.0, pictures="8bit",
        title="as LLNeRF: as bright as lom on the screen, with a twelfth of its electrons",
        source="LLNeRF represents low-light scenes with noise; moderately low-light behavior with additional noise",
    ),
    LightLevel(
        sensor="a7s2-iso6400", electrons=2.0, pictures="8bit",
        title="as LLRS: near zero, noise as strong as the signal",
        source="LLRS is concentrated near zero with extreme noise",
    ),
    LightLevel(
        sensor="d850-iso400", electrons=5.0, pictures="16bit",
        title="as MVTV: extremely dark, in the wide range of a camera for bright light",
        source="MVTV (16-bit) spans a wide dynamic range under extreme low-light conditions",
    ),
)  # fmt: skip


def _chips(level: LightLevel) -> LightLevel:
    """The same with all three channels in every pixel: noise that is independent between pixels and channels."""
    return LightLevel(
        **(vars(level) | {"sensor": level.sensor + CHIPS, "title": f"{level.title}; without demosaicing"})
    )


LEVELS: dict[str, LightLevel] = {}
for _name, _level in zip(("lom", "llnerf", "llrs", "mvtv"), _MOSAIC, strict=True):
    LEVELS |= {_name: _level, _name + CHIPS: _chips(_level)}
assert all(level.sensor in PRESETS for level in LEVELS.values())


def level_named(name: str) -> LightLevel:
    """A level by name.

    Raises:
        ValueError: If no level has this name.
    """
    if name not in LEVELS:
        hint = meant(name, LEVELS)
        raise ValueError(f"unknown level {brief(repr(name), 60)}; {hint}available: {', '.join(LEVELS)}")
    return LEVELS[name]
