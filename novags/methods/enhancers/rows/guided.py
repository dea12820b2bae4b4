"""The paper's enhancement as a row: see `guided.py`; its configuration, every method's default, is in `choice.py`."""

from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.enhancer import Enhancer
from sensor_model.files.registry import Later

ENHANCER = Enhancer(
    EnhanceConfig,
    Later("novags.methods.enhancers.guided:enhance"),
    Later("novags.methods.enhancers.guided:typical"),
    title="the paper's: a power law of a map of brightness that a guided filter smooths",
)
