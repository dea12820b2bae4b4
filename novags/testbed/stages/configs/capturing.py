"""How to photograph a set in the dark."""

import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from novags.numbers import SIDE, check_range
from novags.settings import check_seed
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.ledger.contents import folder_digest
from novags.testbed.stages.layouts import check_layouts
from sensor_model.files.camera_file import CameraFile, read_camera, split_iso
from sensor_model.files.dng import TIMES
from sensor_model.files.reading import brief, meant
from sensor_model.frame import own
from sensor_model.isp import DEMOSAIC, Demosaic
from sensor_model.params import Exposure, Sensor
from sensor_model.planner import Limits
from sensor_model.presets import PRESETS

if TYPE_CHECKING:
    from novags.testbed.importing.calibration.dark_frames import DarkFolder

FULL_SIZE = tuple(name for name in DEMOSAIC if name != "half")  # pictures must be as large as their cameras say


BRIGHTEST = 1e9  # e-; cameras hold 1e6 at most


LARGEST_ERROR = 100.0  # of the noise's standard deviation, in units of it


LONGEST_BURST = 1000  # frames


STOPS, MIRED = 10.0, 300.0  # the largest spreads: a thousandfold exposure, tungsten taken for blue sky


# Settings under which a view is one exposure, and all views are alike.
AS_ONE: dict[str, float] = {"burst": 1, "exposure_spread": 0.0, "white_balance_spread": 0.0, "bracket": 0.0}


ROW_LENGTH = 33  # px; the enhancement averages over such windows, so noise that rows share adds up in them


@dataclass(frozen=True, kw_only=True)
class CaptureConfig:
    """How to photograph a set in the dark."""

    sensor: str = "a7s2-iso6400-3chip"  # a name of sensor_model.PRESETS, or a camera's TOML file
    electrons: float = 20.0  # mean signal of the green channel over the set, e- per pixel and exposure
    time: float = 1 / 30  # s; only the dark current depends on it, since `electrons` fixes the light
    seed: int = 0
    max_size: int | None = None  # px; scale larger images down to this longest side
    demosaic: Demosaic = "menon"  # for sensors with a colour filter array
    jpeg_quality: int | None = None  # 1..100: the 8-bit pictures go through JPEG; None: they do not
    tolerance: float | None = 0.05  # leave out effects that change the noise by less; None simulates all
    dark_frames: Path | None = None  # of this camera: all that is there without light is drawn from them
    burst: int = 1  # frames of each view, whose mean is its picture
    exposure_spread: float = 0.0  # stops; each view's time is drawn up to so far from `time`, evenly in stops
    white_balance_spread: float = 0.0  # mired; each view's white balance errs by up to so much
    bracket: float = 0.0  # stops; every second view is exposed so much longer
    export: tuple[str, ...] = ()  # further layouts of the capture: "blender", "llff"
    camera: Sensor = field(init=False)  # the camera named by `sensor`: a file is read once, and its content is hashed
    measured: tuple[tuple[str, str], ...] = field(init=False)  # hashes of its maps and dark frames, by name

    def __post_init__(self) -> None:
        file = camera_file(self.sensor)
        object.__setattr__(self, "camera", file.sensor)
        maps = [] if file.maps is None else [("maps", folder_digest(file.maps.parent, (), beside={"maps": file.maps}))]
        frames = [] if self.dark_frames is None else [("dark_frames", self.dark_folder(file).digest())]
        object.__setattr__(self, "measured", (*maps, *frames))
        if not 0 < self.electrons <= BRIGHTEST:
            raise ValueError(f"electrons must be > 0 and at most {BRIGHTEST:g}, got {self.electrons}")
        if self.max_size is not None:
            check_range("max_size", self.max_size, 1, SIDE, " px")
        if self.demosaic not in FULL_SIZE:
            raise ValueError(f"demosaic must be one of {', '.join(FULL_SIZE)}, got {self.demosaic!r}")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be None or in 1..100, got {self.jpeg_quality}")
        check_seed(self.seed)
        check_layouts(self.export)
        if self.time and not TIMES[0] <= self.time <= TIMES[1]:  # refuses negative times too
            raise ValueError(f"time must be 0 or in {TIMES} s, the range of its raw files, got {self.time}")
        self._check_uneven()
        self.exposure, self.limits(1)  # they check the rest
        check_range("tolerance", self.tolerance or 0, 0, LARGEST_ERROR)

    def _check_uneven(self) -> None:
        check_range("burst", self.burst, 1, LONGEST_BURST, " frames")
        for name, most, unit in (("exposure_spread", STOPS, "stops"), ("bracket", STOPS, "stops"),
                                 ("white_balance_spread", MIRED, "mired")):  # fmt: skip
            check_range(name, getattr(self, name), 0, most, f" {unit}")
        if not self.uneven:
            return
        if self.export:
            raise ValueError(f"export must be empty where exposure or white balance differs by view, which the layouts "
                             f"{', '.join(self.export)} cannot state")  # fmt: skip
        if self.dark_frames is not None and (self.exposure_spread or self.bracket):
            raise ValueError(
                "dark_frames must be left out where exposure times differ by view: they were taken at one time, got "
                f"exposure_spread {self.exposure_spread:g} and bracket {self.bracket:g}"
            )
        ends = self.time * 2.0**-self.exposure_spread, self.time * 2.0 ** (self.exposure_spread + self.bracket)
        if (self.exposure_spread or self.bracket) and not TIMES[0] <= ends[0] < ends[1] <= TIMES[1]:
            raise ValueError(f"time must leave the exposures of all views in {TIMES} s, the range of their raw files, "
                             f"got {self.time} s and {ends[0]:.3g} to {ends[1]:.3g} s")  # fmt: skip

    @property
    def uneven(self) -> bool:
        """Whether views differ in exposure or white balance."""
        return any((self.exposure_spread, self.white_balance_spread, self.bracket))

    @property
    def sensor_name(self) -> str:
        """Name of the preset or of the camera's file."""
        return title_of(self.sensor)

    def dark_folder(self, file: CameraFile | None = None) -> "DarkFolder":
        """Where its dark frames are."""
        from novags.testbed.importing.calibration.dark_frames import find_dark_frames  # imports readers of pictures

        assert self.dark_frames is not None
        return find_dark_frames(self.dark_frames, file or camera_file(self.sensor))

    def resolved(self) -> dict[str, Any]:
        """The settings that determine the pictures: the camera itself, neither the path of its file nor further
        layouts. Settings of `AS_ONE` are among them where they change something.
        """
        own = ("export", "dark_frames", "measured")
        kept = {name: value for name, value in asdict(self).items()
                if name not in own and (name, value) not in AS_ONE.items()}  # fmt: skip
        kept |= dict(self.measured)
        truth = {"truth": "three channels"} if self.camera.cfa else {}  # earlier versions kept the mosaic alone
        return kept | truth | {"sensor": self.sensor_name}

    @property
    def code(self) -> Code:
        """What takes it."""
        return code_of("novags.testbed.stages.capturing", *self.modules)

    @property
    def modules(self) -> tuple[str, ...]:
        """Of the camera's effects from outside: results of the capture depend on them too."""
        return own.modules(self.camera)

    @property
    def noise_seed(self) -> int:
        """Seed of the random numbers. Captures of one camera and `seed` share them, so that studies compare pairs."""
        return self.seed

    @property
    def exposure(self) -> Exposure:
        """As the sensor model's own type."""
        return Exposure(time=self.time)

    def limits(self, pixels: int) -> Limits | None:
        """The error allowed for leaving effects out of images of so many pixels; None: nothing is left out.

        Beside the mean of a burst, whose variance is so many times smaller, fixed patterns count so many times as much.
        """
        if self.tolerance is None:
            return None
        return Limits(sd=self.tolerance / self.burst, row_length=ROW_LENGTH, pixels=pixels)


@dataclass(frozen=True, kw_only=True)
class OwnNoiseConfig(CaptureConfig):
    """A capture whose noise no other one shares: a network trained on several cannot learn the random numbers."""

    drawn: int  # seed of the random numbers; `seed` says which of several exposures of the same light it is

    @property
    def noise_seed(self) -> int:
        """Seed of the random numbers."""
        return self.drawn


def title_of(sensor: str) -> str:
    """The name of a preset, or of a camera's file; with its ISO as presets have it, mine-iso3200."""
    file, iso = split_iso(sensor)
    return sensor if sensor in PRESETS else Path(file).stem + ("" if iso is None else f"-iso{iso:g}")


def camera_file(name: str) -> CameraFile:
    """A preset by name, with the ISO of its name, or the camera in a TOML file.

    Raises:
        ValueError: If there is no such preset, or the file is missing or does not describe a camera.
    """
    if name in PRESETS:
        named = re.search(r"-iso(\d+)", name)
        return CameraFile(sensor=PRESETS[name], iso=float(named[1]) if named else None)
    if not split_iso(name)[0].endswith(".toml"):
        raise ValueError(
            f"unknown sensor {brief(repr(name), 100)}; {meant(name, PRESETS)}give a camera's .toml file, or one of "
            f"{', '.join(PRESETS)}"
        )
    return read_camera(name)
