"""After Denoise-GS: denoising that learns from renders too, and a second fit (`denoised_twice.py`)."""

from dataclasses import dataclass

from novags.methods.denoised.config import DenoisedConfig
from novags.methods.denoised.config import parts as one_round
from novags.methods.memory import Memory
from novags.methods.variant import Method
from sensor_model.files.registry import Later


@dataclass(frozen=True, kw_only=True)
class DenoisedTwiceConfig(DenoisedConfig):
    """All choices; those of `DenoisedConfig` are of both rounds.

    Attributes:
        render_weight: Of the renders of the first round beside the data, in the second adaptation; 1: a render counts
            as much as a second exposure. The published weight is not known.
    """

    render_weight: float = 1.0

    def __post_init__(self) -> None:
        if self.denoise.adapt is None:
            raise ValueError("denoise.adapt must not be none: the network learns from the renders as it adapts")
        if not self.render_weight > 0:
            raise ValueError(f"render_weight must be > 0, got {self.render_weight}: denoise-gs is without renders")


def parts(config: DenoisedTwiceConfig) -> dict[str, int]:
    """`Method.parts`: both rounds."""
    once = one_round(config)
    return {"denoiser": once["denoiser"], "first fit": once["fit"], "denoiser again": once["denoiser"],
            "fit": once["fit"]}  # fmt: skip


METHOD = Method(
    title="denoise and fit as denoise-gs does, then let the network learn from the renders too, denoise and fit again",
    family="2D + GS",
    color="#a05195",
    config=DenoisedTwiceConfig,
    train=Later("novags.methods.rivals.denoised_twice:train"),
    parts=parts,
    source="Denoise-GS, whose U-Net is refined by renders before a second fit; a network of ours in its place",
    memory=Memory(fixed=0.6e9, pictures=4.0, work=100.0),
)
