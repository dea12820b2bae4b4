"""What the planner knows about Mitsuba's plugins; it simulates unknown ones fully."""
# tests/plugins holds a scene for each of these and compares its plan with everything on: docs/what-mitsuba-plugins.md.

from __future__ import annotations

from typing import Any

from simscenes.loading.contents import class_of, objects_in

# By the names of their classes, which loaded objects know; "BitmapTextureImpl[float32]" counts as the part before "[".
UNDERSTOOD = frozenset({
    # Materials: their lobes (`bsdf.flags()`) say the rest.
    "BlendBSDF", "BumpMap", "CircularPolarizer", "Hair", "LinearPolarizer", "LinearRetarder", "MaskBSDF", "Measured",
    "MeasuredPolarized", "NormalMap", "Null", "PolarizedPlastic", "Principled", "PrincipledThin", "RoughConductor",
    "RoughDielectric", "RoughPlastic", "SmoothConductor", "SmoothDielectric", "SmoothDiffuse", "SmoothPlastic",
    "ThinDielectric", "TwoSidedBRDF",
    # Lights: Mitsuba has none that is polarised.
    "AreaLight", "ConstantBackgroundEmitter", "DirectionalArea", "DirectionalEmitter", "EnvironmentMapEmitter",
    "PointLight", "Projector", "SpotLight", "SunskyEmitter", "TimedSunskyEmitter",
    # Media and their phase functions: Mitsuba has none that polarises.
    "BlendPhaseFunction", "HGPhaseFunction", "HeterogeneousMedium", "HomogeneousMedium", "IsotropicPhaseFunction",
    "RayleighPhaseFunction", "SGGXPhaseFunction", "TabulatedPhaseFunction",
    # Numbers and colours over surfaces, space and wavelengths.
    "BitmapTextureImpl", "BlackBodySpectrum", "Checkerboard", "ConstVolume", "D65Spectrum", "GridVolume",
    "IrregularSpectrum", "MeshAttribute", "RawConstantTexture", "RegularSpectrum", "SRGBReflectanceSpectrum",
    "UniformSpectrum", "VolumeAdapter",
})  # fmt: skip
# Plugins whose only purpose is to polarise: how much that changes is measured, never guessed.
FILTERS = frozenset({"CircularPolarizer", "LinearPolarizer", "LinearRetarder", "MeasuredPolarized"})


def not_understood(scene: Any, mi: Any) -> list[str]:
    """Classes in a loaded scene that change its light in ways the planner does not know, in order."""
    kinds = (mi.BSDF, mi.Emitter, mi.Medium, mi.PhaseFunction, mi.Texture, mi.Volume)
    found = {class_of(o) for o in objects_in(scene, mi) if isinstance(o, kinds)}
    return sorted(found - UNDERSTOOD)


def filters_in(scene: Any, mi: Any) -> list[str]:
    """Classes of the polarising filters and retarders in a loaded scene, in order."""
    return sorted({class_of(o) for o in objects_in(scene, mi) if isinstance(o, mi.BSDF)} & FILTERS)
