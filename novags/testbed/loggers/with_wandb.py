"""Weights & Biases; with WANDB_MODE=offline into the folder, which `wandb sync` sends later."""

from collections.abc import Mapping
from pathlib import Path

from novags.testbed.loggers import Sink


def sink(folder: Path, name: str) -> Sink:
    """As `LOGGERS` says."""
    import wandb

    folder.mkdir(parents=True, exist_ok=True)
    run = wandb.init(project="novags", name=name, dir=str(folder), reinit="create_new")

    def add(step: int, values: Mapping[str, float]) -> None:
        run.log(dict(values), step=step)

    return Sink(add, run.finish)
