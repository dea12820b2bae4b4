"""How to find the cameras of photographs."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from novags.cameras.settings import FEATURES, Mapper, Pictures, check_one_of
from novags.numbers import SIDE, check_range
from novags.settings import check_seed
from novags.testbed.folders.photographs.video import is_video
from novags.testbed.folders.set import for_photographs
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.stages.seen import SEEN
from sensor_model.files.door import resolved

FPS = 2.0  # of a video, if not given


FASTEST = 100_000  # frames a second of a video
Looked = Literal["auto"] | Pictures
Mapped = Literal["auto"] | Mapper


@dataclass(frozen=True, kw_only=True)
class PosesConfig:
    """How to find the cameras of photographs."""

    photographs: Path  # a folder, or a video file
    fps: float | None = None  # frames taken from each second of a video; None: `FPS`
    max_size: int | None = 1600  # px; photographs are scaled down to this longest side before anything else
    max_features: int = 4096  # per picture, the largest ones
    peak_threshold: float = 0.0067  # contrast of a feature, 0..1; COLMAP's own
    pictures: Looked = "auto"  # that are looked for features; auto: denoised if the photographs are dark, else raw
    mapper: Mapped = "auto"  # auto: global with denoised pictures, else incremental
    seed: int = 0

    def __post_init__(self) -> None:
        if self.fps is not None and not (np.isfinite(self.fps) and self.fps > 0):
            raise ValueError(f"fps must be > 0, got {self.fps}")
        if self.fps is not None and self.photographs.is_dir():
            raise ValueError(f"fps belongs to a video, and {self.photographs} is a folder, whose photographs are all "
                             f"taken: leave out fps, got {self.fps:g}")  # fmt: skip
        if self.max_size is not None and self.max_size < 64:
            raise ValueError(f"max_size must be >= 64 px, because smaller pictures hold too few features, got "
                             f"{self.max_size}")  # fmt: skip
        if self.max_features < 100 or not 0 < self.peak_threshold < 1:
            raise ValueError(f"max_features must be >= 100 and peak_threshold in (0, 1), got {self.max_features} and "
                             f"{self.peak_threshold}")  # fmt: skip
        for what, value, kinds in (("pictures", self.pictures, Pictures), ("mapper", self.mapper, Mapper)):
            if value != "auto":
                check_one_of(f"{what} of poses", value, kinds)
        check_range("fps", self.frames_a_second, 0, FASTEST, " frames a second")
        check_range("max_size", self.max_size or SIDE, 64, SIDE, " px")
        check_range("max_features", self.max_features, 100, FEATURES)
        check_seed(self.seed)

    def resolved(self) -> dict[str, Any]:
        """The settings that determine the result, apart from the content of the photographs."""
        kept = {name: value for name, value in asdict(self).items() if name != "photographs"}
        return kept | {"fps": self.frames_a_second if is_video(self.photographs) else None}

    @property
    def code(self) -> Code:
        """What finds them."""
        looked = ("raw", "denoised") if self.pictures == "auto" else (self.pictures,)
        return code_of("novags.testbed.stages.posing", *map(SEEN.module_of, looked), *for_photographs())

    def search(self, dark: bool) -> tuple[Pictures, Mapper]:
        """The pictures that are looked for features, and the mapper, of photographs that are `dark` or not."""
        pictures = self.pictures
        if pictures == "auto":
            pictures = "denoised" if dark else "raw"
        mapper = self.mapper
        if mapper == "auto":
            mapper = "global" if pictures == "denoised" else "incremental"
        return pictures, mapper

    @property
    def frames_a_second(self) -> float:
        """Of a video."""
        return FPS if self.fps is None else self.fps

    @property
    def name(self) -> str:
        """Name of the scene: the folder's (of the one above, if it is one of many called images), or the video's."""
        path = resolved(self.photographs)
        if path.name in ("images", "input", "photos"):
            return path.parent.name
        return path.name if path.is_dir() else path.stem  # a folder has no suffix: garden.1 keeps its whole name
