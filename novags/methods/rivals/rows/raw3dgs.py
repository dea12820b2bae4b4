"""Raw3DGS: raw data without the noise that a network extracts from them, and Gaussians, trained together
(`raw3dgs.py`).
"""

from dataclasses import dataclass, field

from novags.methods.denoised.config import AdaptConfig
from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE
from novags.methods.enhancers.choice import EnhanceConfig, Enhancement
from novags.methods.inputs import Pictures
from novags.methods.memory import Memory
from novags.methods.variant import Method, Variant
from novags.splats.training.config import FitConfig
from sensor_model.files.registry import Later

FEW = 20  # views, up to which the published weight of the likelihood is the smaller one


@dataclass(frozen=True, kw_only=True)
class Raw3dgsConfig:
    """All choices.

    Attributes:
        fit: Of the Gaussians; `fit.dssim_weight` has no effect.
        epsilon: Of the loss of the render, in units of white, as in RawNeRF and LE3D; the publication gives none.
        noise_weight: Of the negative log likelihood of the extracted noise; None: 5 as published, of at most `FEW`
            views 3.
        covariance_weight: Of the distance of its covariance from that of white noise.
        patch: Side of the patches whose covariance that is, px. Ours: 4 is two cells of a mosaic, so that pixels of one
            filter are neighbours in it too.
        extractor_rate: Learning rate of the network beside the fit, a tenth of it in the last sixth.
        pretrain: How the network is brought to the noise of the capture before the fit; None: it starts as shipped.
        init_scale: Of an initial Gaussian, in distances to its nearest neighbours.
        pictures: Through whose enhancement the result is shown, and compared with methods that enhance.
        enhance: That enhancement.
    """

    fit: FitConfig = ORIGINAL_FIT
    epsilon: float = 1e-3
    noise_weight: float | None = None
    covariance_weight: float = 20.0
    patch: int = 4
    extractor_rate: float = 1e-4
    pretrain: AdaptConfig | None = field(default_factory=lambda: AdaptConfig(batch=2))
    init_scale: float = ORIGINAL_SCALE
    pictures: Pictures = "8bit"
    enhance: Enhancement = field(default_factory=EnhanceConfig)

    def __post_init__(self) -> None:
        if not self.epsilon > 0:
            raise ValueError(f"epsilon must be > 0 (black renders would be divided by zero), got {self.epsilon}")
        if not min(self.noise_weight or 0, self.covariance_weight, self.extractor_rate) >= 0:
            raise ValueError(
                "noise_weight, covariance_weight and extractor_rate must be >= 0, got "
                f"{self.noise_weight}, {self.covariance_weight} and {self.extractor_rate}"
            )
        if self.patch < 1:
            raise ValueError(f"patch must be >= 1 px, got {self.patch}")

    def noise_weight_of(self, views: int) -> float:
        """Of the likelihood, for so many training views."""
        if self.noise_weight is not None:
            return self.noise_weight
        return 3.0 if views <= FEW else 5.0


def parts(config: Raw3dgsConfig) -> dict[str, int]:
    """`Method.parts`: the network alone, then beside the fit."""
    return {"pretraining": 0 if config.pretrain is None else config.pretrain.steps, "fit": config.fit.iterations}


METHOD = Method(
    title="the light of the scene, fitted to the raw data without the noise that a network extracts from them, which "
    "learns beside the fit",
    family="3DGS",
    color="#8c564b",
    config=Raw3dgsConfig,
    train=Later("novags.methods.rivals.raw3dgs:train"),
    parts=parts,
    source="Raw3DGS (Li et al. 2024, From Chaos to Clarity)",
    memory=Memory(fixed=0.62e9, pictures=4.0, work=90.0),
)

NO_COVARIANCE = Variant(
    name="raw3dgs-no-cov",
    method="raw3dgs",
    title="Raw3DGS without the term that keeps the extracted noise white",
    settings={"covariance_weight": 0.0},
)
