"""Scenes of published data sets by name, for study files: "data:LOM/buu", or "data:LOM/*" for all scenes there.

`--data` names the folder below which they are looked for. A data set that is not there leaves no run; it is said.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from novags.testbed.importing.published.datasets import DATASETS, expected, scenes_below

DATA = "data:"  # begins the name of such a scene


@dataclass(frozen=True)
class DataFolder:
    """The data sets of a study.

    Attributes:
        root: The folder that --data named; None: none.
        scenes: The scenes below it, "LOM/buu" -> its folder.
    """

    root: Path | None = None
    scenes: Mapping[str, Path] = field(default_factory=dict)

    @staticmethod
    def of(root: Path | None) -> "DataFolder":
        """The scenes below a folder.

        Raises:
            ValueError: If there is no such folder, or two scenes of a data set have one name.
        """
        found = {} if root is None else scenes_below(root)
        return DataFolder(root, {f"{name}/{scene}": path for name in found for scene, path in found[name].items()})

    def matching(self, value: Any) -> list[Any]:
        """The scenes that a value of the axis `scene` stands for; [] for a data set that is not there.

        Raises:
            ValueError: If there is no such data set or no such scene in it, or --data is missing.
        """
        if not isinstance(value, str) or not value.startswith(DATA):
            return [value]
        name, _, pattern = value.removeprefix(DATA).partition("/")
        dataset = next((known for known in DATASETS if known.lower() == name.lower()), None)
        if dataset is None or not pattern:
            raise ValueError(f"{value!r} must be {DATA}NAME/SCENE or {DATA}NAME/* with one of {', '.join(DATASETS)}")
        if self.root is None:
            raise ValueError(f"{value!r} is a scene of a data set: say with --data DIR where these are")
        there = [scene for scene in self.scenes if scene.startswith(f"{dataset}/")]
        found = [scene for scene in there if fnmatchcase(scene.lower(), f"{dataset}/{pattern}".lower())]
        if there and not found:
            near = get_close_matches(f"{dataset}/{pattern}", there, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(there)}"
            raise ValueError(f"{self.root} has no scene {dataset}/{pattern}; {hint}")
        return [f"{DATA}{scene}" for scene in found]

    def absent(self, values: list[Any]) -> list[str]:
        """The data sets that values of the axis `scene` name and that are not there.

        Raises:
            ValueError: If there is a folder of data sets, and none is named.
        """
        named = {value.removeprefix(DATA).partition("/")[0].lower() for value in values if str(value).startswith(DATA)}
        if self.root is not None and not named:
            raise ValueError(f"--data {self.root}: no scene begins with {DATA!r}, so that nothing is read there")
        there = {scene.partition("/")[0] for scene in self.scenes}
        return [name for name in DATASETS if name.lower() in named and name not in there]

    def nothing(self, absent: list[str]) -> str:
        """The message where nothing but these is named."""
        return (f"{self.root} holds none of {', '.join(absent)}: download them into folders of their names. Expected "
                f"for each scene: {expected(absent)}")  # fmt: skip
