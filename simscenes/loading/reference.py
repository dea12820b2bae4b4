"""Which scene is meant: a catalogue name, a Mitsuba dict or an XML file. The one place that tells them apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from simscenes.scenes import split_name

SceneLike = str | dict[str, Any] | Path


@dataclass(frozen=True, kw_only=True)
class SceneRef:
    """A scene that is not loaded yet.

    Attributes:
        kind: "catalogue", "file" or "dict".
        name: Catalogue name with its seed ("tabletop:3"), stem of the file, or "custom".
        path: The Mitsuba XML file, or None.
        description: The Mitsuba dict, or None.
    """

    kind: Literal["catalogue", "file", "dict"]
    name: str
    path: Path | None = None
    description: dict[str, Any] | None = None

    @classmethod
    def of(cls, scene: SceneLike | SceneRef) -> SceneRef:
        """What is meant by a name from `SCENES` ("tabletop:3" for variation 3), a dict, a path or a text in .xml.

        Raises:
            ValueError: If a name is not in the catalogue, or the scene is neither a name, a dict nor a file. Files
                are not opened.
        """
        if isinstance(scene, SceneRef):
            return scene
        if isinstance(scene, Path) or (isinstance(scene, str) and scene.endswith(".xml")):
            return cls(kind="file", name=Path(scene).stem, path=Path(scene))
        if isinstance(scene, str):
            split_name(scene)
            return cls(kind="catalogue", name=scene)
        if isinstance(scene, dict) and scene.get("type") == "scene":
            return cls(kind="dict", name="custom", description=scene)
        raise ValueError(
            f"scene must be a name from SCENES, a .xml file or a Mitsuba dict of type 'scene', got {scene!r:.80}"
        )

    @property
    def in_catalogue(self) -> bool:
        """Whether it is a catalogue scene, which has a default rig; others are seen from around their own sensor."""
        return self.kind == "catalogue"
