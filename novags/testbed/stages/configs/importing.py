"""Knowledge about dark photographs besides their files."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from novags.numbers import SIDE, check_range
from novags.testbed.folders.set import for_photographs
from novags.testbed.importing.published.datasets import DATASETS
from novags.testbed.importing.split import Split
from novags.testbed.importing.stored import Codes16, Curve
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.stages.configs.capturing import FULL_SIZE, camera_file, title_of
from sensor_model.files.dng import TIMES
from sensor_model.frame import own
from sensor_model.isp import Demosaic
from sensor_model.params import Sensor


@dataclass(frozen=True, kw_only=True)
class ImportConfig:
    """Knowledge about dark photographs besides their files."""

    lit: Path | None = None  # well-lit pictures of the same views
    clean: Path | None = None  # long exposures of the same views in the same light
    sensor: str | None = None  # a name of sensor_model.PRESETS or a camera's TOML file: gives methods the noise
    time: float | None = None  # s, of the dark exposures; None: from raw files, else unknown and counted as 0
    black: float = 0.0  # code of no light in 16-bit files
    white: float = 65535.0  # code of white in them
    curve: Curve = "auto"  # of their codes in between; auto: as the file says, else linear
    demosaic: Demosaic = "menon"  # for raw files with a colour filter array
    max_size: int | None = None  # px; scale larger pictures down to this longest side
    split: Split = "own"  # which views are held out
    dataset: str = "auto"  # the published data set that the folder is a scene of; auto: by its looks; or none
    camera: Sensor | None = field(init=False)  # the camera named by `sensor`
    iso: float | None = field(init=False)  # of that camera; None: not known

    def __post_init__(self) -> None:
        file = None if self.sensor is None else camera_file(self.sensor)
        object.__setattr__(self, "camera", None if file is None else file.sensor)
        object.__setattr__(self, "iso", None if file is None else file.iso)
        if self.time is not None and not (self.time == 0 or TIMES[0] <= self.time <= TIMES[1]):
            raise ValueError(f"time must be 0 or in {TIMES} s, the range of raw files, got {self.time}")
        if self.max_size is not None:
            check_range("max_size", self.max_size, 1, SIDE, " px")
        if self.demosaic not in FULL_SIZE:
            raise ValueError(f"demosaic must be one of {', '.join(FULL_SIZE)}, got {self.demosaic!r}")
        if self.curve not in get_args(Curve):
            raise ValueError(f"curve must be one of {', '.join(get_args(Curve))}, got {self.curve!r}")
        if self.split not in get_args(Split):
            raise ValueError(f"split must be one of {', '.join(get_args(Split))}, got {self.split!r}")
        if self.dataset not in ("auto", "none", *DATASETS):
            raise ValueError(f"dataset must be auto, none or one of {', '.join(DATASETS)}, got {self.dataset!r}")
        self.codes  # noqa: B018 - it checks the levels

    @property
    def code(self) -> Code:
        """What imports them."""
        return code_of("novags.testbed.stages.importing", *self.modules)

    @property
    def modules(self) -> tuple[str, ...]:
        """Results of photographs depend on these, and on the effects from outside of their camera."""
        return (*for_photographs(), *own.modules(self.camera))

    @property
    def codes(self) -> Codes16:
        """The meaning of 16-bit codes."""
        return Codes16(black=self.black, white=self.white, curve=self.curve)

    @property
    def sensor_name(self) -> str | None:
        """Name of the preset or of the camera's file."""
        return None if self.sensor is None else title_of(self.sensor)

    def resolved(self) -> dict[str, Any]:
        """The settings that determine the result, besides the content of folders."""
        return {
            "sensor": self.sensor_name, "camera": self.camera, "time": self.time, "black": self.black,
            "white": self.white, "curve": self.curve, "demosaic": self.demosaic, "max_size": self.max_size,
            "split": self.split,
        }  # fmt: skip
