"""NOVA-GS as a row of `METHODS`."""

from novags.methods.memory import Memory
from novags.methods.nova.config import NovaConfig, parts
from novags.methods.nova.knobs import KNOBS
from novags.methods.variant import Method
from sensor_model.files.registry import Later

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
    memory=Memory(fixed=0.65e9, pictures=3.0),
)
