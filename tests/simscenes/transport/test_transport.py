"""The planner leaves out only what its bound allows, and finds what it must find."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, default_rig, plan_transport
from simscenes.backend import activate, backend_of, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.radiance import RenderedView, RenderMethod
from simscenes.scenes import SCENES
from simscenes.transport.effects import _is_chromatic
from simscenes.transport.plan import MADE_UP, TransportPlan
from simscenes.transport.planner import everything_on

SceneMaker = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def plain(diffuse_box: SceneMaker, ring: Rig) -> TransportPlan:
    return plan_transport(diffuse_box(), rig=ring)


def test_a_matt_scene_needs_indirect_light_and_nothing_else(plain: TransportPlan) -> None:
    roulette = plain.is_on("Russian roulette")  # by what it measured; it is not an effect of light
    assert [e.name for e in plain.effects if e.on and e.name != "Russian roulette"] == ["indirect light"]
    assert plain.color == "rgb"
    rr_depth = plain.rr_depth if roulette else plain.max_depth + 1
    assert plain.integrator() == {"type": "path", "max_depth": plain.max_depth, "rr_depth": rr_depth}
    assert plain["polarisation"].contribution == 0
    assert plain.bound == pytest.approx(sum(e.contribution for e in plain.effects if not e.on and e.unit != "px"))
    assert plain.bound <= 0.02


def test_a_plan_prints_and_survives_json(plain: TransportPlan) -> None:
    import json

    text = str(plain)
    assert all(e.name in text for e in plain.effects)
    assert TransportPlan.from_dict(json.loads(json.dumps(plain.to_dict()))) == plain


def test_a_measured_plan_says_what_it_saves(plain: TransportPlan, diffuse_box: SceneMaker, ring: Rig) -> None:
    assert set(plain.seconds) == {"planned", "everything on"}
    assert all(0 < s < np.inf for s in plain.seconds.values())
    assert "times less time" in str(plain)
    bounded = plan_transport(diffuse_box(), rig=ring, measure=False)
    assert bounded.seconds == {}
    everything = everything_on(plain)
    assert everything.color == "spectral_polarized"
    assert everything.integrator()["max_depth"] == 64


def test_a_black_body_scene_needs_direct_light_only(ring: Rig) -> None:
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.01}}
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": black}, "sky": {"type": "constant"}}
    plan = plan_transport(scene, rig=ring)
    assert not plan.is_on("indirect light")
    assert plan.integrator()["max_depth"] == 2


def test_fog_switches_the_integrator_and_coloured_fog_the_sampler(diffuse_box: SceneMaker, ring: Rig) -> None:
    for sigma_t, kind in ((0.4, "volpath"), ({"type": "rgb", "value": [0.2, 0.4, 0.8]}, "volpathmis")):
        fog = {"type": "homogeneous", "albedo": {"type": "rgb", "value": 0.5}, "sigma_t": sigma_t, "scale": 2.0}
        cloud = {"type": "sphere", "radius": 1.2, "bsdf": {"type": "null"}, "interior": fog}
        plan = plan_transport(diffuse_box(cloud=cloud), rig=ring, measure=False)
        assert plan.is_on("participating media")
        assert plan["participating media"].contribution > 0.05
        assert plan.integrator()["type"] == kind


def test_glass_goes_deeper_than_matt_things(diffuse_box: SceneMaker, ring: Rig) -> None:
    glass = {"type": "dielectric", "int_ior": "bk7", "ext_ior": "air"}
    nested = {
        f"shell_{k}": {"type": "sphere", "center": [0, 0, 0.5], "radius": 0.9 - 0.1 * k, "bsdf": glass}
        for k in range(4)
    }
    plan = plan_transport(diffuse_box(**nested), rig=ring, measure=False)
    assert plan.max_depth > 8
    assert plan["polarisation"].contribution > 0


def test_only_colours_make_a_medium_chromatic() -> None:
    mi = activate()
    for shape, chromatic in (((3, 3, 3, 1), False), ((2, 2, 2, 3), True)):
        grid = mi.VolumeGrid(np.arange(np.prod(shape), dtype=np.float32).reshape(shape) / 50 + 0.1)
        density = {"type": "gridvolume", "grid": grid, "raw": True}
        medium = mi.load_dict({"type": "heterogeneous", "sigma_t": density, "albedo": 0.5})
        assert _is_chromatic(mi, medium) == chromatic


def difference(
    scene: str, rig: Rig, plan: TransportPlan, reference: TransportPlan, spp: int
) -> dict[str, tuple[float, float]]:
    """Absolute differences over all light: of the whole mean, and averaged over 4 x 4 blocks; each with its error."""
    images, variances = [], []
    for made in (plan, reference):
        with using_variant(backend_of(), made.color) as mi:
            loaded = build_scene(scene, mi)
            method = RenderMethod(mi, mi.variant(), loaded, mi.load_dict(made.integrator()))
            seen = [RenderedView(method, rig, i).render(spp, None) for i in range(len(rig))]
        images.append(np.stack([v.mean for v in seen]).astype(np.float64).mean(-1))
        # The channels of a pixel err together.
        variances.append(np.stack([v.variance for v in seen]).astype(np.float64).mean(-1))
    gap, variance, total = images[0] - images[1], variances[0] + variances[1], images[1].mean()
    n, h, w = gap.shape
    blocks = np.abs(gap.reshape(n, 4, h // 4, 4, w // 4).mean((2, 4)))
    spread = np.sqrt(variance.reshape(n, 4, h // 4, 4, w // 4).mean((2, 4)) * 16 / (h * w))
    whole = abs(float(gap.mean())), float(np.sqrt(variance.mean() / gap.size))
    return {"whole": (whole[0] / total, whole[1] / total), "blocks": (blocks.mean() / total, spread.mean() / total)}


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize(
    "name", [n if n in ("cornell", "hall") else pytest.param(n, marks=pytest.mark.slow) for n in SCENES]
)
def test_what_is_left_out_stays_below_the_stated_bound(name: str) -> None:
    """Against a render with everything on: deep paths, media, spectra, polarisation."""
    rig = default_rig(name, 2, 32, 32)
    plan = plan_transport(name, rig=rig)
    everything = everything_on(plan)
    assert "spectral" in everything.color
    found = difference(name, rig, plan, everything, 256)
    bound = plan.bound + plan.biases.get(MADE_UP, 0.0)  # everything includes spectra, made-up ones too
    change, error = found["whole"]
    assert change <= bound + 5 * error
    # The mean of 32 absolute normal deviates is 0.8 standard deviations, and beyond 1.25 once in 10^4 times.
    change, error = found["blocks"]
    assert change <= bound + 1.25 * error
