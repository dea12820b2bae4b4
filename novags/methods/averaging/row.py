"""The average over views by truth as a row of `METHODS`."""

from novags.methods.averaging.config import AveragingConfig
from novags.methods.memory import Memory
from novags.methods.variant import Method
from sensor_model.files.registry import Later

METHOD = Method(
    title="bring the training exposures to the view by the true surface and average them by inverse variance: what "
    "counting statistics across views alone can give",
    family="bound",
    color="#6b6b6b",
    config=AveragingConfig,
    train=Later("novags.methods.averaging.trainer:train"),
    source="the Gauss-Markov theorem, and cubic convolution (Keys 1981)",
    sees_clean=True,
    sees_surface=True,
    memory=Memory(fixed=0.6e9, pictures=3.6),
)
