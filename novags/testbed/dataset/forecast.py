"""The cost of a data set, before any work."""

from collections.abc import Mapping
from pathlib import Path

from novags.testbed.dataset.file import SPLITS, DatasetConfig
from novags.testbed.dataset.recipes.listed import size_of
from novags.testbed.ledger.store import costs
from novags.testbed.study import forecast as of_study
from novags.testbed.study.costs import Costs
from novags.testbed.study.engines.choice import Engine
from novags.testbed.study.plan import StudyPlan


def forecast(
    plan: StudyPlan, config: DatasetConfig, divided: Mapping[str, str], store: Path, out: Path, engine: Engine
) -> str:
    """A page for a terminal: the forecast of the work, the splits, the disk that the data set takes beside the store.

    Args:
        plan: Of the data set.
        config: Of the data set.
        divided: The split of each scene.
        store: The store.
        out: Folder of the data set.
        engine: Where the work would be done.
    """
    found = Costs.of(costs(store), engine.threads)
    disk = {key: found.predicted(task).disk for key, task in plan.tasks.items()}
    size = sum(disk.values())
    # Samples are of captures, and each holds its own copy of the picture and the truth in good light.
    shards = sum(disk[key] + sum(disk[need] for need in plan.tasks[key].needs) for key in plan.ends)
    linked = _device(store) == _device(out)
    training = size_of(config.recipes, [cell.preset for cell in plan.study.cells])
    beside = (0.0 if linked else size) + (0.0 if config.shard_mb is None else shards) + training
    copied = ["shards"] * (config.shard_mb is not None) + list(config.recipes)
    parts = ", and ".join(["links" if linked else "copies", *filter(None, [", ".join(copied)])])
    lines = [of_study.forecast(plan, store, engine), "", f"  data set {config.name}: about {of_study.size(size)}; "
             f"beside the store it takes {of_study.size(beside)} ({parts})"]  # fmt: skip
    for split in SPLITS:
        if scenes := [scene for scene, where in divided.items() if where == split]:
            more = f" and {len(scenes) - 8} more" if len(scenes) > 8 else ""
            lines.append(f"  {split:<7} {len(scenes):>4} scenes: {', '.join(scenes[:8])}{more}")
    return "\n".join(lines)


def _device(path: Path) -> int:
    return next(parent for parent in (path.absolute(), *path.absolute().parents) if parent.exists()).stat().st_dev
