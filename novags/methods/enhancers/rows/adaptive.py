"""The adaptive tone curves of 2026 as rows: see `curves/adaptive.py`."""

import math
from dataclasses import dataclass

from novags.methods.enhanced.by_enhancer import by_enhancer
from novags.methods.enhancers.enhancer import Enhancer, EnhancerConfig
from sensor_model.files.registry import Later

SOURCE = "Adaptive tone curves (arXiv 2606.11841), of which the repository's README tells the constants"


@dataclass(frozen=True, kw_only=True)
class AdaptiveConfig(EnhancerConfig):
    """The settings of both curves, which lift black to o = offset (1 - p10 / p90)^exponent.

    Attributes:
        gain: c: how much the mean of the picture raises the curve.
        offset: Of black, where the picture has full contrast.
        exponent: As the README has it; the program's own default is 1.5.
        scene_wide: Take the statistics of all training pictures in the mean, which vary less from view to view.
        statistics: p90, p10 and mean luma in codes 0..1, for all pictures; None: of each picture, or of the scene.
    """

    gain: float
    offset: float = 0.12
    exponent: float = 2.5
    scene_wide: bool = False
    statistics: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.gain < math.inf:
            raise ValueError(f"gain must be >= 0 and finite, got {self.gain}")
        if not (0 <= self.offset < 1 and 0 < self.exponent < math.inf):
            raise ValueError(f"offset must lie in [0, 1) and exponent be > 0, got {self.offset} and {self.exponent}")
        if self.statistics is not None:
            p90, p10, mean = self.statistics
            if not (0 <= p10 <= p90 <= 1 and p90 > 0 and 0 <= mean <= 1):
                raise ValueError(f"statistics must be p90, p10 and mean in 0..1, p90 > 0 and p10 <= p90, got "
                                 f"{self.statistics}")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class AseConfig(AdaptiveConfig):
    """Adaptive SoftExp: y = o + (1 - o) (1 - exp(-(k + c m) x / p90)).

    Attributes:
        gain: As published for RealX3D; 3 for LOM, 0 for views of varying exposure.
        slope: k.
    """

    gain: float = 4.0
    slope: float = 0.9

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.slope < math.inf:
            raise ValueError(f"slope must be > 0 and finite, got {self.slope}")


@dataclass(frozen=True, kw_only=True)
class Ap3Config(AdaptiveConfig):
    """Adaptive Poly3: y = o + (1 + c m) (.0720 t³ - .4376 t² + .9948 t), t = x / p90, clipped.

    Attributes:
        gain: As published for RealX3D; 1 for LOM, 0 for views of varying exposure.
    """

    gain: float = 2.0


_TYPICAL = Later("novags.methods.enhancers.curves.curve:mean_params")  # the authors' form for whole scenes takes it
_SETTLED = Later("novags.methods.enhancers.curves.adaptive:settled")
ASE = Enhancer(
    AseConfig, Later("novags.methods.enhancers.curves.adaptive:ase"), _TYPICAL, settled=_SETTLED,
    title="a saturating exponential that the picture's quantiles and mean shape (Adaptive SoftExp, 2026)",
)  # fmt: skip
AP3 = Enhancer(
    Ap3Config, Later("novags.methods.enhancers.curves.adaptive:ap3"), _TYPICAL, settled=_SETTLED,
    title="a cubic that the picture's quantiles and mean shape (Adaptive Poly3, 2026)",
)  # fmt: skip
ASE_METHOD = by_enhancer(AseConfig(), "raise each picture by an adaptive exponential", "#7d6b2f", SOURCE)
AP3_METHOD = by_enhancer(Ap3Config(), "raise each picture by an adaptive cubic", "#6f7d2f", SOURCE)
