"""Structure from motion with features and matches of networks (hloc)."""

from dataclasses import dataclass

from novags.cameras.settings import Mapper, Pictures, check_kind, check_mapping
from novags.cameras.source import CameraConfig, CameraSource
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class HlocConfig(CameraConfig):
    """Which features and matcher, by hloc's names, and how reliable a match must be.

    DISK and LightGlue are the default because their code and weights are Apache-2 and come with a plain installation;
    SuperPoint and SuperGlue need a recursive clone and are for non-commercial research.
    """

    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    features: str = "disk"  # of hloc: disk, aliked-n16, superpoint_aachen, superpoint_max, sift, ...
    matcher: str = "auto"  # of hloc: disk+lightglue, superglue, NN-ratio, ...; auto: LightGlue for them, else NN-ratio
    mapper: Mapper = "incremental"  # grow from one pair, or solve for all cameras at once (GLOMAP)
    min_matches: int = 10  # geometrically consistent ones that a pair needs in order to count, as in sfm
    max_error: float = 2.0  # px, from the epipolar line, as in sfm
    threads: int = 1  # of verification and mapping; more change the result

    def __post_init__(self) -> None:
        check_kind("hloc", self.pictures)
        check_mapping("hloc", self.mapper, self.min_matches, self.max_error, self.threads)


SOURCE = CameraSource(
    "the same with learned features (hloc), by your own installation",
    HlocConfig,
    Later("novags.cameras.motion.hloc:check_installed"),
    Later("novags.cameras.motion.hloc:hloc_cameras"),
    "pictures and lenses",
)
