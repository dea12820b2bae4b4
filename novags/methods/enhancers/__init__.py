"""A dark picture in, a bright one out: one file per enhancer in `rows` (of networks: `networks/rows`), one line of text
in `ENHANCERS`.

The functions here need no picture; `applying.py` enhances pictures.
"""

import dataclasses
from pathlib import Path
from typing import Any

from novags.methods.enhancers.choice import Enhancement
from novags.methods.enhancers.enhancer import Enhancer
from novags.methods.inputs import LacksInput, Pictures
from novags.settings import changed
from sensor_model.files.reading import brief, meant
from sensor_model.files.registry import Registry

ENHANCERS: Registry[Enhancer] = Registry(
    {
        "guided": "novags.methods.enhancers.rows.guided:ENHANCER",
        "gamma": "novags.methods.enhancers.rows.gamma:ENHANCER",
        "gain": "novags.methods.enhancers.rows.gain:ENHANCER",
        "drago": "novags.methods.enhancers.rows.drago:ENHANCER",
        "equalise": "novags.methods.enhancers.rows.equalise:ENHANCER",
        "ase": "novags.methods.enhancers.rows.adaptive:ASE",
        "ap3": "novags.methods.enhancers.rows.adaptive:AP3",
        "naka": "novags.methods.enhancers.rows.naka:ENHANCER",
        "zero-dce": "novags.methods.enhancers.networks.rows.zero_dce:ENHANCER",
        "sci": "novags.methods.enhancers.networks.rows.sci:ENHANCER",
        "mbllen": "novags.methods.enhancers.networks.rows.mbllen:ENHANCER",
        "uretinex": "novags.methods.enhancers.networks.rows.uretinex:ENHANCER",
        "retinexformer": "novags.methods.enhancers.networks.rows.retinexformer:ENHANCER",
        "naka-net": "novags.methods.enhancers.networks.rows.naka_net:ENHANCER",
        "none": "novags.methods.enhancers.rows.none:ENHANCER",
    },
    "novags.enhancers",
    Enhancer,
)


def enhancer_of(config: Any) -> tuple[str, Enhancer]:
    """The enhancer that has a configuration of this very type, and its name.

    Raises:
        ValueError: If none has.
    """
    kind = type(config)
    # The row beside the configuration first: then no other one is loaded.
    beside = [name for name in ENHANCERS if ENHANCERS.module_of(name) == kind.__module__]
    for name in (*beside, *ENHANCERS):
        if (enhancer := ENHANCERS[name]).config is kind:
            return name, enhancer
    raise ValueError(f"no enhancer has a configuration like {kind.__name__}; available: {', '.join(ENHANCERS)}")


def network_of(config: Any) -> Any:
    """The `networks.Kind` behind the enhancer of a configuration; None if there is none, or no such enhancer."""
    try:
        _, enhancer = enhancer_of(config)
    except ValueError:
        return None
    return None if enhancer.network is None else enhancer.network()


def refuse_without_weights(config: Any, name: str) -> None:
    """Refuse settings that are known to fail before any picture is taken: a network without weights that learns from no
    scene.

    Args:
        config: Of a method.
        name: Of the method or variant, for the message.

    Raises:
        LacksInput: If its enhancer is one.
    """
    enhance = getattr(config, "enhance", None)
    kind = network_of(enhance)
    if kind is not None and kind.rehearsal is None:
        try:
            kind.refuse_without_weights(enhance)
        except LacksInput as error:
            raise LacksInput(f"{name}: {error}") from error


def enhancement_record(config: Enhancement, pictures: Pictures) -> dict[str, Any]:
    """A run's record of its enhancement.

    Raises:
        ValueError: If no enhancer has such a configuration.
    """
    name, _ = enhancer_of(config)
    settings = {} if config is None else dataclasses.asdict(config)
    return {"enhancer": name, "pictures": pictures, "config": settings}


def recorded(enhancement: dict[str, Any]) -> tuple[Enhancer, Any]:
    """The enhancer of a record, and its configuration.

    Raises:
        ValueError: If there is no such enhancer, or it has other settings.
    """
    name = enhancement["enhancer"]
    if name not in ENHANCERS:
        hint = meant(str(name), ENHANCERS)
        raise ValueError(f"unknown enhancer {brief(repr(name), 100)}; {hint}available: {', '.join(ENHANCERS)}")
    config = ENHANCERS[name].config()
    if config is None:
        return ENHANCERS[name], None
    try:
        return ENHANCERS[name], changed(config, enhancement["config"])
    except ValueError as error:
        raise ValueError(f"the recorded settings of {name} do not fit this version ({error}): run it again") from error


def why_not_here(enhancement: dict[str, Any]) -> str | None:
    """Why the enhancer of a record cannot be used: of a package that is gone, or another version; None where it can."""
    try:
        recorded(enhancement)
    except ValueError as error:
        return str(error)
    return None


def located(enhancement: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The enhancement that a run in a folder has recorded, with its files of weights where they are."""
    config = enhancement["config"]
    weights = config.get("weights")
    if not isinstance(weights, list):
        return enhancement
    return {**enhancement, "config": {**config, "weights": [str(folder / str(name)) for name in weights]}}
