"""The floor and the ceiling with the learning rates and the growth of nova-plus."""

from novags.methods.enhanced.config import ORIGINAL_FIT
from novags.methods.nova_plus.config import FIT
from novags.methods.variant import Variant
from novags.settings import flattened

_ORIGINAL = flattened(ORIGINAL_FIT)
_QUICK = {
    f"fit.{name}": value
    for name, value in flattened(FIT).items()
    if name.startswith(("rates.", "mcmc.")) and value != _ORIGINAL[name]
}

NAIVE_L1 = Variant(
    name="naive-l1-fast-rates",
    method="naive",
    title="as naive-l1, with the learning rates and the growth of nova-plus",
    settings={"fit.dssim_weight": 0.0, **_QUICK},
)

ORACLE = Variant(
    name="oracle-fast-rates",
    method="oracle",
    title="the ceiling with the learning rates and the growth of nova-plus",
    settings=_QUICK,
)
