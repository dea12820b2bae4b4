"""TensorBoard: event files, which `tensorboard --logdir FOLDER` shows."""

from collections.abc import Mapping
from pathlib import Path

from novags.testbed.loggers import Sink


def sink(folder: Path, name: str) -> Sink:
    """As `LOGGERS` says."""
    from torch.utils.tensorboard import SummaryWriter

    writer = SummaryWriter(str(folder / name))

    def add(step: int, values: Mapping[str, float]) -> None:
        for key, value in values.items():
            writer.add_scalar(key, value, step)

    return Sink(add, writer.close)
