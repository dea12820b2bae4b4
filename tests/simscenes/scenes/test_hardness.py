"""Every scene is hard for what its docstring says, in numbers, and the others are less so."""

import gc
from typing import Any

import numpy as np
import pytest

from simscenes import SCENES, default_rig
from simscenes.backend import activate
from simscenes.loading.load import build_scene
from simscenes.render.geometry import geometry_channels
from simscenes.scenes.parts.remembered import remembered
from simscenes.transport import pilot
from simscenes.transport.lengths import SPECULAR


def facts(name: str) -> dict[str, float]:
    """What three small views of a scene show."""
    mi = activate()
    loaded, rig = build_scene(name, mi), default_rig(name, 3, 32, 32)
    found: dict[str, Any] = {}
    images = {
        depth: pilot.render_pilot(mi, loaded, rig, {"type": "path", "max_depth": depth, "rr_depth": 99}, seed=1)
        for depth in (2, 5, 64)
    }
    light = images[64].mean(-1)
    found["indirect"], found["fifth bounce"] = (1 - float(images[d].mean() / images[64].mean()) for d in (2, 5))
    found["range"] = float(light.max() / np.median(light))
    found["contrast"] = float(np.quantile(light, 0.98) / np.quantile(light, 0.02))
    views = [geometry_channels(mi, loaded, rig, i) for i in range(3)]
    z = np.minimum(np.stack([v["Z"] for v in views]), 1e6)  # the sky is far away
    steps = np.abs(np.diff(z, axis=2)) / np.minimum(z[:, :, 1:], z[:, :, :-1])
    found["depth edges"] = float((steps > 0.1).mean())
    specular = np.array([False, *(bool(s.bsdf().flags() & SPECULAR) for s in loaded.scene.shapes())])
    found["specular pixels"] = float(specular[np.stack([v["id"] for v in views])].mean())
    del loaded
    gc.collect()  # Dr.Jit compiles every material alive into every kernel
    return found


@pytest.mark.parametrize(
    ("name", "fact", "least", "most"),
    [
        ("cornell", "indirect", 0.06, 0.15),  # "a tenth of it here"
        ("courtyard", "contrast", 30, 1e3),  # "more than 30 to 1"
        ("studio", "specular pixels", 0, 0),  # "every surface is diffuse"
        ("gallery", "fifth bounce", 0.2, 1),  # "much of the light has bounced four times and more"
        ("lantern", "range", 1e4, 1e6),  # "tens of thousands of times brighter than the walls"
        ("thicket", "depth edges", 0.4, 1),  # "every pixel mixes foreground and background"
        ("glassware", "specular pixels", 0.15, 1),
        ("tabletop", "specular pixels", 0.05, 0.5),
    ],
)
def test_a_scene_is_hard_for_what_it_says(name: str, fact: str, least: float, most: float) -> None:
    assert least <= facts(name)[fact] <= most


def test_every_scene_draws_from_its_seed_and_a_number_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a slow test of the catalogue sees in the whole of each scene, seen where it begins."""

    class Begun(Exception):
        pass

    def begin(start: list[int]) -> None:
        raise Begun(*start)

    activate()
    monkeypatch.setattr(np.random, "default_rng", begin)
    own = dict[str, tuple[Any, ...]]()
    for name in SCENES:
        with pytest.raises(Begun) as begun:
            SCENES[name](99)  # no scene has this number
        seed, *own[name] = begun.value.args
        assert seed == 99, name
    assert len({tuple(numbers) for numbers in own.values()}) == len(own)


def test_fine_and_many_coloured_things_are_there_in_full() -> None:
    activate()
    lattice = SCENES["thicket"](0)["lattice"]
    assert lattice.vertex_count() == 8 * (19 + 12)  # two crossed strips a wire
    card = SCENES["market"](0)["card_0"]["bsdf"]
    assert "[96, 32]" in str(card)  # three chips of 32 px, of three colours
    toys = SCENES["tabletop"](0)
    papers = {str(toys[f"wall_{side}"].bsdf()) for side in ("north", "south", "east", "west")}
    covers = {str(toys[f"book_{k}"]["bsdf"]) for k in range(4)}
    assert len(papers) == len(covers) == 4  # told apart by their mean colour


def test_a_texture_is_remembered_by_all_that_it_is_made_of_wherever_the_generator_stands() -> None:
    made = []

    @remembered
    def spots(*what: Any, size: int = 2) -> np.ndarray:
        made.append(what)
        (rng,) = (part for part in what if isinstance(part, np.random.Generator))
        return rng.random((size, size, 3)).astype(np.float32)

    def drawn(seed: int, *, first: bool = False, kind: str = "a", size: int = 2) -> tuple[np.ndarray, float]:
        rng = np.random.default_rng(seed)
        return spots(*((rng, kind) if first else (kind, rng)), size=size), rng.random()

    for first in (False, True):
        begun = len(made)
        texels, after = drawn(0, first=first)
        again, as_well = drawn(0, first=first)
        assert len(made) == begun + (not first)  # in either order it is made of the same
        assert (again == texels).all()
        assert as_well == after
    for other in ({"seed": 1}, {"seed": 0, "kind": "b"}, {"seed": 0, "size": 3}):
        begun = len(made)
        drawn(**other)
        assert len(made) == begun + 1, other
