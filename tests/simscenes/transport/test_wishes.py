"""What the user decides instead of the planner is done with all it needs, or refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, plan_transport, render_set
from simscenes.transport.wishes import check_wishes

SceneMaker = Callable[..., dict[str, Any]]


def test_every_effect_can_be_forced(diffuse_box: SceneMaker, ring: Rig) -> None:
    force = {"indirect light": False, "polarisation": True, "Russian roulette": False}
    forced = plan_transport(diffuse_box(), rig=ring, force=force, max_depth=5)
    assert forced["indirect light"].forced
    assert forced.integrator() == {"type": "path", "max_depth": 2, "rr_depth": 3}
    assert forced.color == "spectral_polarized"
    assert forced["paths beyond max_depth"].forced
    assert forced.bound >= forced["indirect light"].contribution > 0.03
    endless = plan_transport(diffuse_box(), rig=ring, force={"paths beyond max_depth": True}, measure=False)
    assert endless.integrator() == {"type": "path", "max_depth": -1, "rr_depth": 3}
    assert endless["paths beyond max_depth"].on


@pytest.mark.parametrize(
    ("force", "said"),
    [
        ({"magic": True}, "must be one of"),
        ({"depth of field": True}, "pinhole"),
        ({"motion blur": True}, "at rest"),
        ({"paths beyond max_depth": True, "Russian roulette": False}, "needs 'Russian roulette' on"),
        ({"paths beyond max_depth": True, "indirect light": False}, "needs 'indirect light' on"),
        ({"participating media": True}, "holds no medium"),
        ({"chromatic media": True}, "holds no medium"),
        ({"polarisation": True, "spectral transport": False}, "needs 'spectral transport' on"),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_any_pilot(
    force: dict[str, bool], said: str, monkeypatch: pytest.MonkeyPatch, diffuse_box: SceneMaker, ring: Rig
) -> None:
    from simscenes.transport import pilot

    monkeypatch.setattr(pilot, "render_pilot", None)
    with pytest.raises(ValueError, match=said):
        plan_transport(diffuse_box(), rig=ring, force=force)
    with pytest.raises(ValueError, match="max_depth must be at least 2"):
        plan_transport(diffuse_box(), rig=ring, max_depth=1)


FULL = Optics(aperture_radius=0.1, focus_distance=2.0, motion=0.5)
LENS, MOTION, DEEP, FOG, MIS = (
    "depth of field",
    "motion blur",
    "paths beyond max_depth",
    "participating media",
    "chromatic media",
)
SPECTRA, POLARISED = "spectral transport", "polarisation"


@pytest.mark.parametrize(
    ("force", "has", "said"),
    [
        ({LENS: True}, {}, None),
        ({LENS: True}, {"optics": Optics(motion=0.5)}, "'depth of field' is forced on, but the camera is a pinhole"),
        ({LENS: False}, {"optics": Optics()}, None),
        ({MOTION: True}, {}, None),
        ({MOTION: True}, {"optics": Optics()}, "'motion blur' is forced on, but the camera is at rest"),
        ({FOG: True, MIS: True}, {}, None),
        ({MIS: True}, {"media": False}, "'chromatic media' is forced on, but the scene holds no medium"),
        ({SPECTRA: True, POLARISED: True}, {}, None),
        (
            {SPECTRA: True},
            {"spectra": False},
            "'spectral transport' is forced on, but the scene holds parts made for RGB alone",
        ),
        (
            {POLARISED: True},
            {"spectra": False},
            "'polarisation' is forced on, but the scene holds parts made for RGB alone",
        ),
        ({MIS: True, POLARISED: True}, {}, "'chromatic media' forced on needs 'polarisation' off, and that"),
        ({MIS: True, POLARISED: False}, {}, None),
        ({MIS: True, FOG: False}, {}, "'chromatic media' forced on needs 'participating media' on, and that"),
        ({MIS: False, FOG: False}, {}, None),
        ({DEEP: True, "indirect light": True}, {}, None),
        ({}, {"max_depth": 2, "media": False, "spectra": False, "optics": Optics()}, None),
        ({}, {"max_depth": 1}, "max_depth must be at least 2 .lamps and surfaces lit., got 1"),
    ],
)
def test_wishes_are_granted_where_scene_and_camera_can(force: dict[str, bool], has: Any, said: str | None) -> None:
    settings = {"max_depth": None, "optics": FULL, "media": True, "spectra": True} | has
    if said is None:
        check_wishes(force, **settings)
    else:
        with pytest.raises(ValueError, match=said):
            check_wishes(force, **settings)


def test_what_is_on_brings_what_it_needs(diffuse_box: SceneMaker, ring: Rig) -> None:
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.01}}
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": black}, "sky": {"type": "constant"}}
    endless = plan_transport(scene, rig=ring, force={"paths beyond max_depth": True}, measure=False)
    assert endless.integrator()["max_depth"] == -1
    assert endless["indirect light"].reason == "because paths beyond max_depth is on"
    fog = {"type": "homogeneous", "albedo": 0.5, "sigma_t": {"type": "rgb", "value": [0.2, 0.4, 0.8]}, "scale": 2.0}
    cloud = {"type": "sphere", "radius": 1.2, "bsdf": {"type": "null"}, "interior": fog}
    plan = plan_transport(diffuse_box(cloud=cloud), rig=ring, measure=False)
    assert plan.integrator()["type"] == "volpathmis"
    polarised = plan.force(on=["polarisation"])  # volpathmis knows none
    assert (polarised.integrator()["type"], polarised.color) == ("volpath", "spectral_polarized")
    assert polarised.is_on("spectral transport")
    assert np.isnan(polarised.bound)
    assert plan.force(off=["participating media"]).integrator()["type"] == "path"
    assert not polarised.force(off=["spectral transport"]).is_on("polarisation")
    with pytest.raises(ValueError, match="effect name"):
        plan.force(on=["magic"])


def test_motion_blur_can_be_forced_on_a_plan_that_is_made(tmp_path: Path, diffuse_box: SceneMaker, ring: Rig) -> None:
    rig, images = ring, {}
    plan = plan_transport(diffuse_box(), rig=rig, optics=Optics(motion=0.3), measure=False)
    for name, made in (("as planned", plan), ("off", plan.force(off=["motion blur"]))):
        done = render_set(diffuse_box(), rig, tmp_path / name, spp=64, optics=Optics(motion=0.3), plan=made)
        images[name] = done.radiance(1)
    still = render_set(diffuse_box(), rig, tmp_path / "still", spp=64, plan=plan.force(off=["motion blur"]))
    assert np.array_equal(images["off"], still.radiance(1))
    assert not np.allclose(images["as planned"], images["off"], rtol=0.1)
