"""LITA-GS: lit Gaussians, their illumination and their noise (`lita_gs.py`)."""

from dataclasses import dataclass

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.rivals.row import rival
from novags.splats.training.config import FitConfig
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class LitaGsConfig:
    """All choices.

    Attributes:
        pictures: Which pictures it sees.
        fit: Of the Gaussians; `fit.dssim_weight` is w.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        width: Channels of a denoising network.
        prior_weight: Of the structure.
        exposure: Mean code of lit patches.
        exposure_weight: Of the patches' distance from it.
        light_weight: Of the slopes of the illumination, where the colours have no edge.
        smooth_weight: Of the slopes of the lit picture in places where the structure has no edge.
        noise_weight: Of the size of the noise.
        denoiser_rate: Learning rate of the denoising networks.
        tone_rate: Of h.
    """

    pictures: Pictures = "8bit"
    fit: FitConfig = ORIGINAL_FIT
    init_scale: float = ORIGINAL_SCALE
    width: int = 16
    prior_weight: float = 0.01
    exposure: float = 0.49
    exposure_weight: float = 0.1
    light_weight: float = 0.1
    smooth_weight: float = 0.01
    noise_weight: float = 0.01
    denoiser_rate: float = 5e-5
    tone_rate: float = 1e-4

    def __post_init__(self) -> None:
        weights = self.prior_weight, self.exposure_weight, self.light_weight, self.smooth_weight, self.noise_weight
        if min(*weights, self.denoiser_rate, self.tone_rate) < 0:
            raise ValueError(f"weights and rates must be >= 0, got {self}")
        if not 0 < self.exposure < 1:
            raise ValueError(f"exposure must lie in (0, 1), got {self.exposure}")
        if self.width < 1:
            raise ValueError(f"width must be >= 1, got {self.width}")


METHOD = rival(
    LitaGsConfig,
    Later("novags.methods.rivals.lita_gs:train"),
    title="lit colours, illumination and noise of each Gaussian, held to a structure that light does not change; "
    "shown denoised",
    color="#d37295",
    source="LITA-GS (Zhou et al. 2025)",
    memory=Memory(fixed=0.66e9, pictures=1.4, work=203.0),
)
