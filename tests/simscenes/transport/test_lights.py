"""Lights are picked as often as they matter: the mean stays, the noise falls, the bits repeat."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simscenes import Rig, orbit_rig, plan_transport, read_exr, render_set
from simscenes.backend import activate
from simscenes.job.identity import plan_identity
from simscenes.loading.load import LoadedScene, build_scene, set_light_weights
from simscenes.render.radiance import RenderedView, RenderMethod
from simscenes.render.sequences import Radiance
from simscenes.rigs import intrinsics, look_at
from simscenes.transport import lights
from simscenes.transport.lights import in_even_parts, light_weights

pytestmark = pytest.mark.usefixtures("jit")


def two_lamps(dim: float = 0.5, **more: Any) -> dict[str, Any]:
    """A ball on a floor under a strong lamp and a weak one."""
    t = activate().ScalarTransform4f()
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.5, 0.4]}}

    def lamp(x: float, level: float) -> dict[str, Any]:
        place = t.translate([x, 0, 2.5]).rotate([1, 0, 0], 180).scale(0.3)
        glow = {"type": "area", "radiance": {"type": "rgb", "value": level}}
        return {"type": "rectangle", "to_world": place, "emitter": glow}

    floor = {"type": "rectangle", "to_world": t.scale(3), "bsdf": grey}
    ball = {"type": "sphere", "center": [0, 0, 0.5], "radius": 0.5, "bsdf": grey}
    return {"type": "scene", "floor": floor, "ball": ball, "strong": lamp(-1, 9.0), "weak": lamp(1, dim), **more}


def ring(n: int = 2, size: int = 16) -> Rig:
    return orbit_rig(n, size, size, 50, target=(0, 0, 0.4), radius=3.0)


def rendered(loaded: LoadedScene, spp: int = 128) -> Radiance:
    mi = activate()
    integrator = mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 2})
    return RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator), ring(size=40), 0).render(spp, None)


def test_weighing_lights_keeps_the_mean_and_lowers_the_noise() -> None:
    mi = activate()
    loaded = build_scene(two_lamps(), mi)
    even = rendered(loaded)
    weights = light_weights(mi, loaded, ring(), 0)
    assert weights[0] > 2 * weights[1]  # 95 % of the light, but none in its own shadows
    assert sum(weights) == pytest.approx(1, abs=0.01)
    set_light_weights(loaded, weights, mi)
    weighed = rendered(loaded)
    a, b = (r.mean.astype(np.float64) for r in (even, weighed))
    va, vb = (r.variance.astype(np.float64) for r in (even, weighed))
    # Colours of a pixel share their paths, so errors add up over channels before they add in squares over pixels.
    error = np.sqrt((3 * (va + vb).sum(-1)).sum()) / a.size
    assert abs((a - b).mean()) < 5 * error
    assert error < 0.01 * a.mean()
    assert vb.mean() < 0.75 * va.mean()  # 0.63 to 0.66 by seed; with weights between even parts 0.78 and more


def variance_of(weights: Sequence[float], best: Sequence[float]) -> float:
    """Of picking one light by these weights, relative to picking by the best ones."""
    return sum(b * b / w for w, b in zip(weights, best, strict=True)) / sum(best) ** 2


@given(st.lists(st.floats(0.003, 1.0), min_size=2, max_size=40))
def test_even_parts_are_the_coarsest_that_cost_little(amounts: list[float]) -> None:
    best = np.array(amounts) / sum(amounts)
    found = in_even_parts(best)
    parts = next(n for n in (2**k for k in range(1, 30)) if all(float(w * n).is_integer() for w in found))
    assert sum(found) == 1
    assert min(found) > 0
    assert variance_of(found, best) <= 1.015
    if len(best) == 2:  # every coarser choice costs more
        for coarser in range(1, parts // 2):
            w = coarser / (parts // 2)
            assert variance_of((w, 1 - w), best) > 1.015


def test_even_parts_of_known_weights() -> None:
    cases = [((0.5, 0.5), (0.5, 0.5)), ((0.7, 0.3), (0.75, 0.25)), ((0.43, 0.57), (0.375, 0.625))]
    cases += [((0.02, 0.98), (1 / 32, 31 / 32)), ((0.25, 0.5, 0.25), (0.25, 0.5, 0.25))]
    for best, expected in cases:
        assert in_even_parts(np.array(best)) == expected


def test_nothing_is_weighed_where_there_is_no_choice_or_fog() -> None:
    mi = activate()
    fog = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.4}
    cloud = {"type": "sphere", "radius": 4.0, "bsdf": {"type": "null"}, "interior": fog}
    alone = {k: v for k, v in two_lamps().items() if k != "weak"}
    for scene in (alone, two_lamps(cloud=cloud), {"type": "scene", "ball": {"type": "sphere"}}):
        assert light_weights(mi, build_scene(scene, mi), ring(), 0) == ()


def test_a_light_that_reaches_nothing_seen_is_still_picked() -> None:
    mi = activate()
    below = {"type": "point", "position": [0, 0, -5], "intensity": {"type": "rgb", "value": 100.0}}
    weights = light_weights(mi, build_scene(two_lamps(cellar=below), mi), ring(), 0)
    assert min(weights) > 0.02


def test_weights_of_another_scene_are_refused() -> None:
    mi = activate()
    with pytest.raises(ValueError, match="3 lights"):
        set_light_weights(build_scene(two_lamps(), mi), (0.2, 0.3, 0.5), mi)


def test_a_plan_measured_again_is_the_same_plan() -> None:
    plan = plan_transport(two_lamps(), rig=ring(), measure=False)
    slower = replace(plan, seconds={"planned": 2.0, "everything on": 3.0})
    assert plan_identity(plan) == plan_identity(slower)
    assert plan_identity(plan) != plan_identity(replace(plan, max_depth=plan.max_depth + 1))


def test_a_planned_render_is_bit_identical_when_repeated_resumed_and_reordered(tmp_path: Path) -> None:
    views = ring(5)

    def job(folder: str, rig: Rig = views) -> dict[str, np.ndarray]:
        done = render_set(two_lamps(), rig, tmp_path / folder, spp=8)
        assert done.meta["plan"]["light_weights"]
        return {
            p.stem: np.stack([read_exr(p)[0][c] for c in "RGB"]) for p in sorted((tmp_path / folder / "gt").iterdir())
        }

    first, again = job("a"), job("b")
    (tmp_path / "a" / "gt" / "0001.exr").unlink()
    (tmp_path / "a" / "set.json").unlink()
    resumed = job("a")
    for other in (again, resumed):
        assert all(np.array_equal(first[k], other[k]) for k in first)
    order = [3, 0, 4, 1, 2]
    mixed = Rig(viewmats=views.viewmats[order], Ks=views.Ks[order], width=views.width, height=views.height)
    reordered = job("c", mixed)
    assert all(np.array_equal(first[f"{i:04d}"], reordered[f"{k:04d}"]) for k, i in enumerate(order))


def test_a_lamp_is_seen_from_both_sides_of_its_diagonal() -> None:
    """Boards below two quarters of a lamp hide its diagonal from a far point below it, and half of its light."""
    mi = activate()
    t = mi.ScalarTransform4f()
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 9.0}}
    lamp = {"type": "rectangle", "to_world": t.translate([0, 0, 20]).rotate([1, 0, 0], 180), "emitter": glow}
    floor = {"type": "rectangle", "to_world": t.scale(0.01), "bsdf": {"type": "diffuse"}}

    def light(*boards: tuple[float, float]) -> float:
        shapes = {f"board {k}": {"type": "rectangle", "to_world": t.translate([*place, 19.9]).scale(0.5)}
                  for k, place in enumerate(boards)}  # fmt: skip
        loaded = build_scene({"type": "scene", "lamp": lamp, "floor": floor, **shapes}, mi)
        pose = look_at((0, 0, 0.5), (0, 0, 0), (0, 1, 0))
        rig = Rig(viewmats=pose[None], Ks=intrinsics(16, 16, 1)[None], width=16, height=16)
        return float(lights._direct_light(mi, loaded, rig, 0, 1, 0).mean())

    whole = light()
    assert light((-0.5, -0.5), (0.5, 0.5)) == pytest.approx(whole / 2, rel=0.2)
    assert light((-0.5, 0.5), (0.5, -0.5)) == pytest.approx(whole / 2, rel=0.2)
