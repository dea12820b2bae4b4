"""NOVA-GS as a row of `METHODS`."""

from novags.methods.memory import MANY, PICTURE, Memory
from novags.methods.nova.config import NovaConfig, parts
from novags.methods.nova.knobs import KNOBS
from novags.methods.variant import Method
from sensor_model.files.registry import Later

FIGURES = Memory(fixed=0.65e9, pictures=3.0, work=65.0)
STEP, LONG_STEP = 830.0, 75.0  # pictures of its size that a step on a whole view takes, of few and of `MANY` pixels


def memory(config: NovaConfig, views: float, pixels: float, points: int) -> float:
    """`Method.memory`: steps on crops take little, and the maps of the published network much."""
    found, denoiser = FIGURES(config, views, pixels, points), config.denoiser
    if denoiser is None or denoiser.crop is not None:
        return found
    return found + PICTURE * pixels * (STEP if pixels < MANY else LONG_STEP)


METHOD = Method(
    title="NOVA-GS as the paper states it: enhance, denoise with a network that learns from the noisy views alone, "
    "fit with geometric consistency and a penalty on view-dependent colour where noise is strong",
    family="ours",
    color="#0072b2",
    config=NovaConfig,
    train=Later("novags.methods.nova.trainer:train"),
    parts=parts,
    least={"denoiser": 64, "fit": 800},
    knobs=KNOBS,
    source="NOVA-GS: Noise-Aware View-Consistent Gaussian Splatting for Low-Light Novel View Synthesis",
    cameras="vggt",
    memory=memory,
)
