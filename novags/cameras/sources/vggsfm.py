"""The program VGGSfM."""

from dataclasses import dataclass
from pathlib import Path

from novags.cameras.settings import FEATURES, Pictures, check_kind
from novags.cameras.source import CameraConfig, CameraSource
from novags.numbers import VIEWS, check_range
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class VggsfmConfig(CameraConfig):
    """Where it is installed, weights, and how much it tracks."""

    checkpoint: Path  # vggsfm_v2_0_0.bin
    home: Path  # the folder of the clone, with demo.py
    python: str = "python"  # the interpreter of its environment: a whole path, or a name on PATH
    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    query_frames: int = 3  # views whose points are tracked through all others
    query_points: int = 2048  # points of each, at most
    shared_lens: bool = False  # one focal length for all views

    def __post_init__(self) -> None:
        check_kind("vggsfm", self.pictures)
        if self.query_frames < 1 or self.query_points < 8:
            raise ValueError(
                "vggsfm needs query_frames >= 1 and query_points >= 8, the fewest that fix a pair of cameras; got "
                f"{self.query_frames} and {self.query_points}"
            )
        check_range("query_frames of vggsfm", self.query_frames, 1, VIEWS)
        check_range("query_points of vggsfm", self.query_points, 8, FEATURES)


SOURCE = CameraSource(
    "the program VGGSfM, by your own installation and weights",
    VggsfmConfig,
    Later("novags.cameras.networks.vggsfm:check_installed"),
    Later("novags.cameras.networks.vggsfm:vggsfm_cameras"),
    "pictures",
)
