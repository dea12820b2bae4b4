"""Refuses decisions that the user makes instead of the planner, if they cannot be simulated."""

from __future__ import annotations

from simscenes.optics import Optics
from simscenes.transport import plan


def check_wishes(force: dict[str, bool], max_depth: int | None, optics: Optics, *, media: bool, spectra: bool) -> None:
    """Refuse wishes that cannot be simulated.

    Args:
        force: Effect -> on or off.
        max_depth: Longest path.
        optics: The camera.
        media: Whether the scene holds any.
        spectra: Whether the scene can be loaded in spectra.

    Raises:
        ValueError: If an effect is unknown, needs a part that the scene or the camera lacks, or contradicts another
            wish.
    """
    if unknown := set(force) - set(plan.EFFECTS):
        raise ValueError(f"force: an effect must be one of {', '.join(plan.EFFECTS)}, got {', '.join(sorted(unknown))}")
    if max_depth is not None and max_depth < plan.DIRECT_DEPTH:
        raise ValueError(f"max_depth must be at least {plan.DIRECT_DEPTH} (lamps and surfaces lit), got {max_depth}")
    for_rgb = "the scene holds parts made for RGB alone: describe objects as dicts, leave raw out of colours' bitmaps"
    lacking = {
        plan.APERTURE: (optics.aperture_radius is None, "the camera is a pinhole: give Optics an aperture_radius"),
        plan.MOTION: (optics.motion is None, "the camera is at rest: give Optics a motion"),
        plan.MEDIA: (not media, "the scene holds no medium"),
        plan.SPECTRAL_MIS: (not media, "the scene holds no medium"),
        plan.SPECTRAL: (not spectra, for_rgb),
        plan.POLARISATION: (not spectra, for_rgb),
    }
    for name in (name for name, on in force.items() if on):
        lacks, why = lacking.get(name, (False, ""))
        if lacks:
            raise ValueError(f"{name!r} is forced on, but {why}")
        for needed, wanted in plan.NEEDS.get(name, {}).items():
            if force.get(needed, wanted) != wanted:
                state = "on" if wanted else "off"
                raise ValueError(f"{name!r} forced on needs {needed!r} {state}, and that is forced the other way")
