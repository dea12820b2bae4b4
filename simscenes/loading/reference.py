"""Which scene is meant: of the catalogue, a Mitsuba dict, or a file. The one place that tells them apart."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from simscenes.scenes import split_name

NAME = re.compile("[A-Za-z_][A-Za-z0-9_.-]{0,99}")  # of a parameter
SceneLike = str | dict[str, Any] | Path
GLTF = (".gltf", ".glb")
FILES = (".xml", *GLTF)


@dataclass(frozen=True, kw_only=True)
class SceneRef:
    """A scene that is not loaded yet.

    Attributes:
        kind: "catalogue", "file" or "dict".
        name: Catalogue name with its seed ("tabletop:3"), stem of the file, or "custom".
        path: The file, or None.
        description: The Mitsuba dict, or None.
        parameters: Values of a file's $names, (name, value), instead of its <default>s.
        sensor: Which of the scene's own sensors counts, from 0.
    """

    kind: Literal["catalogue", "file", "dict"]
    name: str
    path: Path | None = None
    description: dict[str, Any] | None = None
    parameters: tuple[tuple[str, str], ...] = ()
    sensor: int = 0

    @classmethod
    def of(cls, scene: SceneLike | SceneRef) -> SceneRef:
        """The scene behind a name from `SCENES` ("tabletop:3" for variation 3), a dict, a path or a text in `FILES`.

        Raises:
            ValueError: If a name is not in the catalogue, or the scene is neither a name, a dict nor a file. Files
                are not opened.
        """
        if isinstance(scene, SceneRef):
            return scene
        if isinstance(scene, Path) or (isinstance(scene, str) and is_scene_file(scene)):
            return cls(kind="file", name=Path(scene).stem, path=Path(scene))
        if isinstance(scene, str):
            split_name(scene)
            return cls(kind="catalogue", name=scene)
        if isinstance(scene, dict) and scene.get("type") == "scene":
            return cls(kind="dict", name="custom", description=scene)
        raise ValueError(
            f"scene must be a name from SCENES, a .xml, .gltf or .glb file or a Mitsuba dict of type 'scene', got "
            f"{scene!r:.80}"
        )

    def given(self, parameters: Sequence[str] = (), sensor: int = 0) -> SceneRef:
        """The same scene with "name=value" for its parameters, and another of its sensors.

        Raises:
            ValueError: If a parameter does not read "name=value", a name is given twice, or the scene is not a file.
        """
        pairs = [text.partition("=") for text in parameters]
        for text, (name, equals, _) in zip(parameters, pairs, strict=True):
            if not (equals and NAME.fullmatch(name)):
                raise ValueError(f"a parameter of a scene must be NAME=VALUE, the name of letters, digits and "
                                 f"_ . -, got {text!r:.80}")  # fmt: skip
        names = [name for name, _, _ in pairs]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"parameters of a scene must be given once, got {', '.join(twice)} several times")
        if (pairs or sensor) and self.in_catalogue:
            raise ValueError(f"scene {self.name!r} is of the catalogue: parameters and sensors belong to Mitsuba files")
        if pairs and self.path is not None and self.is_gltf:
            raise ValueError(f"scene {self.name!r} is a glTF file, which has no parameters")
        if sensor < 0:
            raise ValueError(f"the number of a sensor must be >= 0, got {sensor}")
        return replace(self, parameters=tuple((name, value) for name, _, value in pairs), sensor=sensor)

    @property
    def in_catalogue(self) -> bool:
        """Whether it is a catalogue scene, which has a default rig; others are seen from around their own sensor."""
        return self.kind == "catalogue"

    @property
    def is_gltf(self) -> bool:
        """Whether it is a glTF file."""
        return self.path is not None and self.path.suffix in GLTF


def is_scene_file(text: str) -> bool:
    """Whether a text names a scene file, by its ending."""
    return text.endswith(FILES)
