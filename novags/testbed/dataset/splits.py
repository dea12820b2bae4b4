"""Which scenes are for training, validation and testing: none lies in two splits."""

import hashlib
from collections.abc import Sequence

from novags.testbed.dataset.file import SPLITS, DatasetConfig
from sensor_model.files.reading import brief

LARGEST = 1e9  # shares are relative to each other; their sums and products with counts stay far from overflow


def unit_of(scene: str, by: str) -> str:
    """The unit that stays together: a scene with all its variations ("tabletop" of "tabletop:3"), or the variation."""
    head, colon, number = scene.rpartition(":")
    return head if by == "scene" and colon and number.isdigit() else scene


def splits_of(scenes: Sequence[str], config: DatasetConfig) -> dict[str, str]:
    """The split of every scene.

    Scenes that a list names go where it says. The others are dealt out in the proportions of the shares, in an order
    that their names and the seed decide.

    Raises:
        ValueError: If a list names a scene that [grid] lacks or that another list has, if shares are refused, or if a
            split stays empty.
    """
    units = list(dict.fromkeys(unit_of(scene, config.split_by) for scene in scenes))
    found: dict[str, str] = {}
    for name in SPLITS:
        for scene in config.split[name] if isinstance(config.split.get(name), list) else ():
            unit = unit_of(str(scene), config.split_by)
            if unit not in units:
                raise ValueError(f"[dataset.split] {name}: [grid] has no scene {scene!r} (it has {', '.join(units)})")
            if found.setdefault(unit, name) != name:
                raise ValueError(f"[dataset.split] {name}: {unit} lies in {found[unit]} already")
    shares = {name: share for name, share in config.split.items() if not isinstance(share, list)}
    rest = sorted((unit for unit in units if unit not in found), key=lambda unit: _order(unit, config.seed))
    for name, count in _counts(len(rest), shares).items():
        found |= dict.fromkeys(rest[:count], name)
        rest = rest[count:]
    if rest:
        raise ValueError(f"[dataset.split]: {', '.join(rest)} lie in no split: name them in a list, or give a share")
    if empty := [name for name in config.split if name not in found.values()]:
        hint = ': split_by = "variation" divides variations of a scene' if config.split_by == "scene" else ""
        raise ValueError(f"[dataset.split] {empty[0]}: nothing is left for it of {len(units)} scenes: add scenes, or "
                         f"leave it out{hint}")  # fmt: skip
    return {scene: found[unit_of(scene, config.split_by)] for scene in scenes}


def _order(unit: str, seed: int) -> str:
    return hashlib.sha256(f"{seed}/{unit}".encode()).hexdigest()


def _counts(count: int, shares: dict[str, float]) -> dict[str, int]:
    """Whole numbers in proportion to the shares, of sum `count`: the largest remainders are rounded up."""
    for name, share in shares.items():
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 < share <= LARGEST:
            raise ValueError(f"[dataset.split] {name}: it must be a share > 0 and at most {LARGEST:g}, or a list of "
                             f"scenes, got {brief(repr(share))}")  # fmt: skip
    if not shares:
        return {}
    total = sum(shares.values())
    exact = {name: count * share / total for name, share in shares.items()}
    found = {name: int(value) for name, value in exact.items()}
    by_remainder = sorted(shares, key=lambda name: (found[name] - exact[name], SPLITS.index(name)))
    for name in by_remainder[: count - sum(found.values())]:
        found[name] += 1
    for name in shares:  # a small share gets one of the largest split's, if there are enough
        largest = max(found, key=lambda other: found[other])
        if not found[name] and found[largest] > 1:
            found[name], found[largest] = 1, found[largest] - 1
    return found
