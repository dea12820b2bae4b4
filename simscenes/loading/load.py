"""Scenes as they come in: a catalogue name, a Mitsuba dict or an XML file; loaded, checked, named and hashed alike."""

from __future__ import annotations

import gc
import hashlib
import re
import warnings
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from sensor_model.files.door import read_bytes, resolved
from sensor_model.files.reading import brief
from simscenes.backend import COLORS, using_variant
from simscenes.loading.checks.complete import check_complete
from simscenes.loading.checks.meshes import check_faces, check_texture_coordinates
from simscenes.loading.checks.physical import check_parameters, scene_extent
from simscenes.loading.checks.transforms import check_shapes
from simscenes.loading.checks.trial import check_survives
from simscenes.loading.checks.untrusted import check_plugin, check_xml, searching_first, searching_only
from simscenes.loading.checks.usable import masked_lamps, raw_color, why_unusable
from simscenes.loading.contents import parameters_in, unique_materials
from simscenes.loading.digest import content_digest
from simscenes.loading.gltf.describe import described
from simscenes.loading.gltf.document import read_document
from simscenes.loading.integrator import OwnIntegrator, in_dict, in_file, own_integrator
from simscenes.loading.naming import shape_names
from simscenes.loading.obj_files import completed
from simscenes.loading.reference import SceneLike, SceneRef
from simscenes.scenes import build

OLD = re.compile(rb"<scene\s+version\s*=\s*[\"']0\.")
NOT_TRIANGLES = re.compile("trailing tokens|is this a triangle mesh")
DEMANDS = re.compile("spectral|polarized")  # in the messages of plugins that cannot do without


@dataclass(frozen=True)
class LoadedScene:
    """A scene ready to render.

    Attributes:
        name: Catalogue name, name of the file, or "custom".
        variant: The Mitsuba variant it was loaded in, and the only one it can be used in.
        scene: The Mitsuba scene.
        digest: Hash of everything the picture depends on, except the camera and the random numbers.
        shapes: Names of the shapes and instances (see `shape_names`); the id of a pixel is 1 + the index in this list.
        materials: Names of the materials, likewise; those within instances too.
        extent: Diagonal of the bounding box, scene units.
        integrator: The settings of the scene's own integrator; None if it has none.
        sensor: Which of the scene's own sensors counts, from 0.
        rgb_alone: Spectral variants would load it, and fail to render it.
        demand: Why fewer colours cannot load it, in Mitsuba's words; "" for a scene that RGB can.
    """

    name: str
    variant: str
    scene: Any
    digest: str
    shapes: tuple[str, ...]
    materials: tuple[str, ...]
    extent: float
    demand: str = ""
    integrator: OwnIntegrator | None = None
    sensor: int = 0
    rgb_alone: bool = False

    @property
    def own_sensor(self) -> Any:
        """The scene's own sensor in use; None if the scene has none."""
        sensors = self.scene.sensors()
        return sensors[self.sensor] if self.sensor < len(sensors) else None

    @property
    def color(self) -> str:
        """Its colour representation, one of `COLORS`."""
        return next(color for color in COLORS if self.variant.endswith(f"_{color}"))


def build_scene(scene: SceneLike | SceneRef, mi: Any, *, allow_outside: bool = False) -> LoadedScene:
    """Load a scene under the active variant.

    Args:
        scene: A name from `SCENES`, optionally with a scene seed ("tabletop:3"); a Mitsuba scene dict; or the path of a
            Mitsuba XML or a glTF file (anything ending in .xml, .gltf or .glb).
        mi: The mitsuba module, from `activate`.
        allow_outside: Let an XML file read files outside its own folder.

    A file is shaded once in the scalar variant (`checks.shading`), which names what wide ones answer with black. A dict
    is not: it may hold objects of the active variant, which no other variant takes.

    Raises:
        ValueError: If the name is unknown, the file reaches outside its folder, Mitsuba refuses the description (its
            reason is in the message) or crashes on it, the scene has no shapes, or one of its numbers is not physical.
    """
    source = SceneRef.of(scene)
    if source.path is not None:
        files = scene_files(source, allow_outside)
        check_survives(source.path, files, mi.variant(), source.parameters, allow_outside=allow_outside)
    return load_here(source, mi, allow_outside=allow_outside)


def scene_files(source: SceneRef, allow_outside: bool) -> tuple[Path, ...]:
    """The files of a scene that is a file, itself first.

    Raises:
        ValueError: As `check_xml`, or `read_document` for glTF.
    """
    assert source.path is not None
    if source.is_gltf:
        return read_document(source.path, allow_outside=allow_outside).files
    return check_xml(source.path, allow_outside=allow_outside, parameters=source.parameters)


def build_in_fewest_colors(scene: SceneLike | SceneRef, backend: str, *, allow_outside: bool = False) -> LoadedScene:
    """Load a scene in RGB; one that RGB cannot load in spectra, or in polarised spectra.

    Args:
        scene: As for `build_scene`.
        backend: One of `BACKENDS`; no variant stays set.
        allow_outside: As for `build_scene`.

    Raises:
        ValueError: As `build_scene`, with the reason of the last try that came further than asking for other colours.
    """
    demand, refused = "", None
    for color in COLORS:
        with using_variant(backend, color) as mi:
            try:
                return replace(build_scene(scene, mi, allow_outside=allow_outside), demand=demand)
            except ValueError as error:
                refused = error
                if DEMANDS.search(str(error)) is None:
                    break
                demand = demand or str(error).rpartition("] ")[2].strip()
    assert refused is not None
    raise refused


def load_here(source: SceneRef, mi: Any, *, allow_outside: bool = False) -> LoadedScene:
    """As `build_scene`, at the risk of this process."""
    name = source.name
    try:
        loaded, description = _load(source, mi, allow_outside)
    except (RuntimeError, TypeError, KeyError, AttributeError) as error:  # exceptions of Mitsuba and its bindings
        raise ValueError(f"scene {name!r} cannot be loaded: {brief(error, 600)}{_hint(str(error), source)}") from error
    if not isinstance(loaded, mi.Scene) or len(loaded.shapes()) == 0:
        raise ValueError(f"scene {name!r} has no shapes: there is nothing to see")
    if problem := why_unusable(loaded, mi):
        del loaded
        gc.collect()
        raise ValueError(f"scene {name!r} holds {problem}")
    extent = scene_extent(loaded)
    params = parameters_in(loaded, mi)
    check_faces(params)
    check_texture_coordinates(loaded, mi)
    check_parameters(loaded, params, mi)
    check_shapes(loaded, mi)
    for line in masked_lamps(loaded, mi):
        warnings.warn(line, stacklevel=2)
    painted = unique_materials(loaded, mi)  # includes shapes within groups, which get their names only here
    named = list(dict.fromkeys([*loaded.shapes(), *painted]))
    called = dict(zip(named, shape_names(named), strict=True))
    shapes = tuple(called[shape] for shape in loaded.shapes())
    materials = tuple(_material_name(shape, called[shape]) for shape in painted)
    if 0 < len(loaded.sensors()) <= source.sensor:
        raise ValueError(f"scene {name!r} has {len(loaded.sensors())} sensors, numbered from 0; got {source.sensor}")
    digest, own = content_digest(description, params), _own_integrator(source, mi, allow_outside)
    if source.parameters:
        digest = hashlib.sha256(f"{digest}{source.parameters}".encode()).hexdigest()
    return LoadedScene(
        name,
        mi.variant(),
        loaded,
        digest,
        shapes,
        materials,
        extent,
        integrator=own,
        sensor=source.sensor,
        rgb_alone=bool(raw_color(loaded, mi)),
    )


def _hint(said: str, source: SceneRef) -> str:
    """Advice that Mitsuba's words leave out."""
    if "PLYMesh" in said and NOT_TRIANGLES.search(said):
        return (" (Mitsuba reads PLY files of triangles alone, and this one seems to have faces with more corners: "
                "triangulate it, in Blender with Triangulated Mesh in the options of the export)")  # fmt: skip
    if missing := re.search(r"undefined parameter: \$([\w.-]+)", said):
        return f" (give it a value: -D {missing[1]}=VALUE)"
    if source.path is not None and OLD.search(read_bytes(source.path)[:4096]):
        return " (the file is of Mitsuba 0.x, of which Mitsuba 3 reads a part: port it, see its documentation)"
    return ""


def _own_integrator(source: SceneRef, mi: Any, allow_outside: bool) -> OwnIntegrator | None:
    if source.is_gltf:
        return None
    if source.path is None:
        return None if source.description is None else own_integrator(in_dict(source.description))
    path, config = resolved(source.path), mi.parser.ParserConfig(mi.variant())
    with nullcontext() if allow_outside else searching_only(path.parent, mi):
        return own_integrator(in_file(mi.parser.parse_file(config, str(path), **dict(source.parameters)).nodes))


def _load(source: SceneRef, mi: Any, allow_outside: bool) -> tuple[Any, Any]:
    """The Mitsuba scene, and its source: files or a dict."""
    if source.is_gltf and source.path is not None:
        document = read_document(source.path, allow_outside=allow_outside)
        with TemporaryDirectory(prefix="novags-gltf-") as folder:  # meshes; Mitsuba reads them now
            return mi.load_dict(described(document, Path(folder), mi), optimize=False), document.files
    if source.path is not None:
        return _load_xml(source.path, dict(source.parameters), mi, allow_outside)
    return _load_dict(build(source.name) if source.description is None else source.description, mi)


def _load_dict(description: dict[str, Any], mi: Any) -> tuple[Any, Any]:
    _check_plugins(description)
    for key, value in description.items():
        if isinstance(value, mi.Object):
            value.set_id(key)  # meshes made in Python do not know the name they have in the dict
    # optimize=True orders merged objects by memory address: light order and noise would differ in every process.
    return mi.load_dict(description, optimize=False), description


def _check_plugins(node: dict[str, Any]) -> None:
    if isinstance(kind := node.get("type"), str):
        check_plugin(kind)
        kinds = ["ref" for value in node.values() if not isinstance(value, (str, int, float))]  # of any kind
        check_complete(kind, node, kinds, "the scene")
    for child in node.values():
        if isinstance(child, dict):
            _check_plugins(child)


def _load_xml(path: Path, parameters: dict[str, str], mi: Any, allow_outside: bool) -> tuple[Any, Any]:
    files = check_xml(path, allow_outside=allow_outside, parameters=parameters.items())
    root = files[0].parent
    searching = searching_first if allow_outside else searching_only
    with searching(root, mi), completed(files) as file:
        try:
            return mi.load_file(str(file), optimize=False, **parameters), files
        except RuntimeError as error:
            raise RuntimeError(str(error).replace(str(file.parent), str(root))) from error


def set_light_weights(loaded: LoadedScene, weights: tuple[float, ...], mi: Any) -> None:
    """Let the scene pick its lights in proportion to `weights`, one per light; () leaves them alone.

    Raises:
        ValueError: If weights and lights differ in number.
    """
    lights = loaded.scene.emitters()
    if weights and len(weights) != len(lights):
        raise ValueError(f"the plan weighs {len(weights)} lights, scene {loaded.name!r} has {len(lights)}: it was made "
                         "for another scene")  # fmt: skip
    for light, weight in zip(lights, weights, strict=False):
        params = mi.traverse(light)
        params["sampling_weight"] = weight
        params.update()
    loaded.scene.parameters_changed([])


def _material_name(shape: Any, name: str) -> str:
    own = shape.bsdf().id()
    return own if own and not own.startswith("__") else f"{name}.{shape.bsdf().class_name()}"
