"""The method nova-plus as a row of `METHODS`."""

from dataclasses import replace

from novags.methods.memory import Memory
from novags.methods.nova_plus.config import NovaPlusConfig, parts
from novags.methods.nova_plus.knobs import KNOBS
from novags.methods.variant import Method
from sensor_model.files.registry import Later

BETWEEN = Memory(fixed=0.7e9, gaussian=1000.0, pictures=4.0, work=60.0)  # stages: Gaussians rest
MERGED = Memory(fixed=0.7e9, gaussian=1600.0, pictures=2.0, work=60.0)  # and beside them the sets that they come from


def memory(config: NovaPlusConfig, views: float, pixels: float, points: int) -> float:
    """`Method.memory`: of the pictures between stages, or of all seeds that are trained as one set."""
    iterations, each = config.iterations("structure"), config.gaussians_each(views * pixels)
    stage = replace(config.fit, iterations=iterations, cap_max=each)
    gaussians = config.seeds * stage.most(points)
    return max(figures.peak(views, pixels, gaussians) for figures in (BETWEEN, MERGED))


METHOD = Method(
    title="the light of the scene, fitted to the raw data by their known noise, then to denoised data and to "
    "averages guided by the first fit; two seeds, merged",
    family="ours",
    color="#7a3fb0",
    config=NovaPlusConfig,
    train=Later("novags.methods.nova_plus.trainer:train"),
    parts=parts,
    least={"likelihood": 666, "structure": 666},
    knobs=KNOBS,
    source="raw data weighed by their known noise, and 3DGS-MCMC (Kheradmand et al. 2024)",
    memory=memory,
)
