"""Settings of NOVA-GS that have a name of their own: rows of `VARIANTS`."""

from novags.methods.nova.config import NovaConfig
from novags.methods.nova.denoiser_config import FAST_DENOISER
from novags.methods.variant import Variant
from novags.settings import flattened

_PUBLISHED = flattened(NovaConfig())
_FAST = {f"denoiser.{name}": value for name, value in flattened(FAST_DENOISER).items()} | {"consistency.every": 16}

FAST = Variant(
    name="nova-fast",
    method="nova",
    title="NOVA-GS with a small denoiser that trains before the fit only, and a third of the noisy picture in its "
    "target: not the paper's network",
    settings={name: value for name, value in _FAST.items() if value != _PUBLISHED[name]},
)

# The best measured settings of the paper's open points: docs/choices.md.
TUNED = Variant(
    name="nova-tuned",
    method="nova",
    title="NOVA-GS with the best settings that were measured",
    settings={
        "denoiser.noisy_share": 0.7,
        "denoiser.blind_spots.laplacian_share": 0.0,
        "fit.dssim_weight": 0.0,
        "fit.sh_degree": 2,
    },
)

NO_SH = Variant(
    name="nova-no-sh",
    method="nova",
    title="NOVA-GS without the penalty on view-dependent colour",
    settings={"sh_weight": None},
)

NO_GEO = Variant(
    name="nova-no-geo",
    method="nova",
    title="NOVA-GS without geometric consistency",
    settings={"consistency": None},
)

NO_N2V_SH = Variant(
    name="nova-no-n2v-sh",
    method="nova",
    title="NOVA-GS without the denoiser, and so without the penalty that its residual steers",
    settings={"denoiser": None, "sh_weight": None},
)
