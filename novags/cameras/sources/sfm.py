"""Structure from motion by COLMAP."""

from dataclasses import dataclass

from novags.cameras.settings import FEATURES, Mapper, Pictures, check_kind, check_mapping
from novags.cameras.source import CameraConfig, CameraSource
from novags.numbers import check_range
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class SfmConfig(CameraConfig):
    """Which features are matched and how reliable a match must be.

    Chosen on 20 dark pictures of tabletop, 160 x 160. At 5 electrons these settings register all 20 raw ones, 4 with
    COLMAP's peak threshold and 11 with its 15 matches. At 20 electrons first_octave=0 registers 5.
    """

    pictures: Pictures = "raw"  # which pictures are used; the caller provides them
    mapper: Mapper = "incremental"  # grow from one pair, or solve for all cameras at once (GLOMAP)
    max_features: int = 8192  # a picture, the largest ones
    peak_threshold: float = 0.0033  # contrast of a feature; COLMAP's 0.0067 is for large, clean photographs
    first_octave: int = -1  # -1 doubles the picture first, so that features of 1 px count
    min_matches: int = 10  # geometrically consistent ones that a pair needs in order to count
    max_error: float = 2.0  # px, from the epipolar line; COLMAP's 4 are for pictures of several megapixels
    threads: int = 1  # more are faster, but the order of their work changes the result

    def __post_init__(self) -> None:
        check_kind("sfm", self.pictures)
        check_mapping("sfm", self.mapper, self.min_matches, self.max_error, self.threads)
        if self.max_features < 8:
            raise ValueError(f"sfm needs max_features >= 8, the fewest matches of a pair; got {self.max_features}")
        check_range("max_features of sfm", self.max_features, 8, FEATURES)
        if not self.peak_threshold > 0:
            raise ValueError(f"peak_threshold of sfm must be > 0, got {self.peak_threshold}")
        if self.first_octave not in (-1, 0, 1, 2):
            raise ValueError(f"first_octave of sfm must be -1..2, got {self.first_octave}")


SOURCE = CameraSource(
    "structure from motion on the pictures (COLMAP), intrinsics known",
    SfmConfig,
    Later("novags.cameras.motion.sfm:check_installed"),
    Later("novags.cameras.motion.sfm:structure_from_motion"),
    "pictures and lenses",
)
