"""A method, and a method with some settings changed and a name of its own."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from novags.methods.knob import MethodKnob
from novags.methods.memory import Memory
from novags.settings import changed, has_setting
from sensor_model.files.reading import brief, reading
from sensor_model.files.toml_file import read_toml

if TYPE_CHECKING:
    from novags.methods.reconstruction import Reconstruction

Family = Literal["ours", "bound", "2D + GS", "3DGS", "NeRF"]
LONGEST = 100  # characters of a name, which is one of a folder too
NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._+-]{{0,{LONGEST - 1}}}")
SEVERAL = re.compile(r"(.+)(?:\*|-x)(\d+)")  # NAME*3, and NAME-x3, which is the name of its folder
MOST_FITS = 99  # whose mean is taken: one more than the entries of challenges
STATISTICS = "truth_statistics"  # the setting by which a method uses statistics of well-lit pictures


@dataclass(frozen=True, kw_only=True)
class Method:
    """One row of `METHODS`.

    Attributes:
        title: Its work, in a sentence.
        family: Where it belongs in a table.
        color: Of its lines and dots, "#rrggbb".
        config: Makes its configuration as published, a frozen dataclass: the class, or a function of its own.
        train: (problem, config, *, progress, checkpoint) -> Reconstruction. The problem's seed and extent override
            `config.fit`; progress is called with (steps done, of how many, losses); checkpoint is the file that an
            interrupted run goes on from. Raises LacksInput if the problem lacks data that the method needs, ValueError
            for a checkpoint that is damaged or of another run, NotFinite as `splats.fit` does.
        source: The publication or text that it follows.
        parts: The parts of `train` whose steps its progress counts through, and how many each has, for a configuration;
            None: their steps all take the same time.
        least: Steps of these parts below which it is measured to lose by that alone, which is said before it begins.
        knobs: Choices of it that trade accuracy for time, by name; `novags pareto METHOD` measures them.
        cameras: The camera source that the publication uses; None if it does not matter.
        sees_clean: Whether it is given the noise-free exposures; a bound, never a rival.
        sees_surface: Whether it is given the true surface and cameras too; it takes no other cameras.
        memory: (its configuration, training views, pixels of one, first points) -> bytes of main memory at the peak of
            a run on the CPU.
        bound: Which end of the scale of "recovered" it is, "floor" or "ceiling": the cost of noise lies between the
            two.
    """

    title: str
    family: Family
    color: str
    config: Callable[[], Any]
    train: "Callable[..., Reconstruction]"
    source: str
    parts: Callable[[Any], dict[str, int]] | None = None
    least: Mapping[str, int] = field(default_factory=dict)
    knobs: Mapping[str, MethodKnob] = field(default_factory=dict)
    cameras: str | None = None
    sees_clean: bool = False
    sees_surface: bool = False
    memory: Callable[[Any, float, float, int], float] = Memory()
    bound: Literal["floor", "ceiling"] | None = None


def parts_of(method: Method, config: Any, fits: int) -> dict[str, int] | None:
    """`Method.parts` of so many fits, one after another."""
    parts = method.parts(config) if method.parts else None
    if parts is None or fits == 1:
        return parts
    return {f"{part} {k + 1}": steps for k in range(fits) for part, steps in parts.items()}


def refuse_own_frames(method: Method, config: Any, fits: int) -> None:
    """Refuse several fits where each would have cameras, or an enhancing network, of its own.

    Raises:
        ValueError: If that is so: their pictures are of several frames, or of several enhancements, and have no mean
            that one reference could be compared with.
    """
    if fits == 1:
        return
    if getattr(getattr(config, "fit", None), "refine_cameras", None) is not None:
        raise ValueError(f"each of {fits} fits would refine cameras of its own, and pictures of several frames have no "
                         "mean: leave fit.refine_cameras out, or take one fit")  # fmt: skip
    if (method.parts(config) if method.parts else {}).get("enhancer"):
        raise ValueError(f"each of {fits} fits would train an enhancing network of its own, and no reference could be "
                         "compared with all: give enhance.weights, or take one fit")  # fmt: skip


def sees_statistics(config: Any) -> bool:
    """Whether a method with this configuration, or its record, uses statistics of well-lit pictures: never a rival."""
    value = config.get(STATISTICS) if isinstance(config, Mapping) else getattr(config, STATISTICS, None)
    return value is True


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A method under a name, with settings changed.

    Attributes:
        name: Of its folder and its row; the method's own name if nothing is changed.
        method: Name of the method.
        settings: Dotted setting -> value.
        title: Its work, in a sentence; "" for the method's own, with the settings.
        fits: How many fits, each with random numbers of its own, are averaged by pixel.
    """

    name: str
    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    title: str = ""
    fits: int = 1

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise ValueError(f"a variant's name must be letters, digits and . _ + -, at most {LONGEST}, the first no "
                             f"sign, got {brief(repr(self.name), 60)}")  # fmt: skip

    def config(self, default: Any, shared: Mapping[str, Any]) -> Any:
        """The configuration: the method's default, then settings for all methods, then the variant's own.

        Args:
            default: The method's configuration as published.
            shared: Settings for all methods; settings that this one lacks are ignored.

        Raises:
            ValueError: If a setting does not exist, or a value is refused.
        """
        own = {key: value for key, value in shared.items() if has_setting(default, key) and not self.decides(key)}
        return changed(default, {**own, **self.settings}, what=self.name)

    def decides(self, key: str) -> bool:
        """Whether the variant sets this, or switches off a part that it belongs to."""
        return any(key == name or key.startswith(f"{name}.") for name in self.settings)


def spelled_out(name: str) -> str:
    """NAME*3 as it is in names of folders: NAME-x3; other names unchanged."""
    found = SEVERAL.fullmatch(name)
    return name if found is None else f"{found[1]}-x{found[2]}"


def spelled(settings: Mapping[str, Any]) -> str:
    """Settings in a sentence."""
    return ", ".join(f"{name} = {value}" for name, value in settings.items())


def read_variants(path: Path) -> list[Variant]:
    """The variants of a TOML file, a table each: [variant.NAME] with `method` and settings by dotted name.

    Raises:
        ValueError: If the file cannot be read or a table is not a variant.
    """
    tables = read_toml(path).get("variant", {})
    if not isinstance(tables, dict) or not tables:
        raise ValueError(f"{path} has no table [variant.NAME]: there is nothing to compare in it")
    found = []
    for name, table in tables.items():
        if not isinstance(table, dict) or not isinstance(table.get("method"), str):
            raise ValueError(f'{path}: [variant.{name}] needs method = "NAME" of the method that it varies')
        with reading(path, "correct it"):
            settings = {key: value for key, value in dotted(table).items() if key != "method"}
            found.append(Variant(name=name, method=table["method"], settings=settings))
    return found


def dotted(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A table of a TOML file with dotted names for the entries of tables in it: an unquoted a.b = 1 is one."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= dotted(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found


def parse_variant(text: str) -> Variant:
    """`NAME=METHOD:SETTING=VALUE;SETTING=VALUE` as a variant; `,` separates settings too unless values hold it.

    Raises:
        ValueError: If the text is not of this form.
    """
    name, equals, rest = text.partition("=")
    method, colon, listed = rest.partition(":")
    if not (equals and method) or (colon and not listed):
        raise ValueError(
            f"a variant is NAME=METHOD:SETTING=VALUE,SETTING=VALUE (nova-no-sh=nova:sh_weight=none), got "
            f"{brief(repr(text))}"
        )
    # A comma begins a new setting only if "=" follows before the next comma: 16,32,64 is one value.
    settings: dict[str, str] = {}
    for part in re.split(r";|,(?=[^,;=]+=)", listed) if listed else []:
        key, equals, value = part.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise ValueError(
                f"each setting of a variant is NAME=VALUE, got {brief(repr(part), 100)} in {brief(repr(text))}"
            )
        settings[key.strip()] = value.strip()
    return Variant(name=name.strip(), method=method.strip(), settings=settings)
