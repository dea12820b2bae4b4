"""Russian roulette starts where it pays: path lengths are right, and the choice follows noise and work."""

from typing import Any

import numpy as np
import pytest

from simscenes import Rig, default_rig
from simscenes.backend import activate, backend_of
from simscenes.loading.load import build_scene
from simscenes.loading.reference import SceneRef
from simscenes.render import wavefront
from simscenes.render.radiance import RenderedView, RenderMethod
from simscenes.rigs import intrinsics, look_at
from simscenes.transport.effects import roulette_effect
from simscenes.transport.pilot import Pilot, pilot_rig
from simscenes.transport.roulette import MOST_SURVIVE, SPP, TOGETHER, most_efficient, path_lengths, path_noise


def inside_a_ball(albedo: float) -> tuple[Any, Any, Rig]:
    """A camera in a closed matt ball, which every path meets again and again."""
    mi = activate()
    wall = {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
    ball = {"type": "sphere", "radius": 2.0, "flip_normals": True, "bsdf": wall}
    lamp = {"type": "point", "intensity": 1.0}
    rig = Rig(viewmats=look_at((0, 0, 0), (1, 0, 0))[None], Ks=intrinsics(4, 4, 60)[None], width=4, height=4)
    return mi, build_scene({"type": "scene", "ball": ball, "lamp": lamp}, mi), rig


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("albedo", [0.3, 0.9, 0.99])
def test_the_last_of_some_paths_in_a_closed_room_ends_where_chances_say(albedo: float) -> None:
    depth, starts = 10, (1, 2, 5, 11)
    mi, loaded, rig = inside_a_ball(albedo)
    found = path_lengths(mi, loaded, rig, depth, starts, seed=0)
    for start, length in zip(starts, found, strict=True):
        chance, expected = 1.0, 0.0
        for surface in range(1, depth):  # a path of 10 segments ends on its 9th surface or lamp
            expected += 1 - (1 - chance) ** TOGETHER  # the last of them is still alive
            if surface >= start:
                chance = min(albedo**surface, MOST_SURVIVE * chance)
        assert length == pytest.approx(expected, rel=1e-4)
    assert found[-1] == pytest.approx(depth - 1)


@pytest.mark.usefixtures("jit")
def test_views_that_show_nothing_count_as_paths_without_surfaces() -> None:
    """Of three views one looks at a wall that fills it; paths leave the wall for good."""
    mi = activate()
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(9), "bsdf": {"type": "diffuse"}}
    loaded = build_scene({"type": "scene", "wall": wall, "sky": {"type": "constant"}}, mi)
    poses = np.stack([look_at((0, 0, 3), (0.1, 0, 9)), look_at((0, 0, 3), (0, 9, 9)), look_at((0, 0, 3), (0.1, 0, 0))])
    rig = Rig(viewmats=poses, Ks=np.repeat(intrinsics(4, 4, 30)[None], 3, 0), width=4, height=4)
    assert path_lengths(mi, loaded, rig, 8, (2, 9), seed=0) == pytest.approx([1 / 3, 1 / 3])


@pytest.mark.usefixtures("jit")
def test_glass_lets_paths_survive_that_are_dark_only_inside() -> None:
    """At normal incidence 4 % are reflected; light in glass is 1/n^2 as bright, and roulette knows that."""
    mi = activate()
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    loaded = build_scene({"type": "scene", "ball": {"type": "sphere", "bsdf": glass}, "sky": {"type": "constant"}}, mi)

    def lengths(views: int, seed: int) -> list[float]:
        poses = np.repeat(look_at((0, 0, 3), (0, 0, 0), (0, 1, 0))[None], views, 0)
        rig = Rig(viewmats=poses, Ks=np.repeat(intrinsics(64, 64, 0.1)[None], views, 0), width=64, height=64)
        return [float(length) for length in path_lengths(mi, loaded, rig, 5, (1, 9), seed)]

    def alive(k: int, survival: float) -> float:
        """Any of the paths is refracted into the ball, then reflected k times inside it, and survives all of that."""
        return float(1 - (1 - 0.96 * 0.04**k * survival ** (k + 1)) ** TOGETHER)

    expected = [1 + sum(alive(k, survival) for k in range(3)) for survival in (MOST_SURVIVE, 1)]
    first, other, two = lengths(1, 0), lengths(1, 1), lengths(2, 0)
    for found in (first, other, two):  # of 4096 times 8 paths or more; one standard error is 0.007
        assert found == pytest.approx(expected, abs=0.02)
    # Every seed and every view draws paths of its own.
    assert first not in (other, two)
    assert lengths(1, 0) == first


@pytest.mark.usefixtures("jit")
def test_the_start_depends_on_the_scene_and_not_on_the_clock() -> None:
    """In `bookshop`, whose walls are pale, the light that early roulette drops is missed."""
    chosen = {}
    for name in ("cornell", "bookshop"):
        mi = activate()
        rig, source, loaded = pilot_rig(default_rig(name, 8, 256, 256)), SceneRef.of(name), build_scene(name, mi)
        twice = [
            roulette_effect(Pilot(mi, source, loaded, rig, backend_of(), 0.005, 0), False, 8, True, 256 / rig.width)
            for _ in range(2)
        ]
        assert twice[0] == twice[1]
        chosen[name], effect = twice[0]
        assert effect.on
        assert (effect.contribution, effect.bound) == (0, 0)
    assert chosen["cornell"] < chosen["bookshop"]


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("part", [1.0, 0.125])
def test_the_noise_of_paths_is_that_of_pixels_as_small_as_those_of_the_views(part: float) -> None:
    """A slit of light in black, 1/4 of a pixel wide and aslant: a pilot's pixel sees it vary, a small one does not."""
    mi = activate()
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    slit = mi.ScalarTransform4f().rotate([0, 0, 1], 13).rotate([1, 0, 0], 180).scale([0.13, 9, 1])
    scene = {"type": "scene", "slit": {"type": "rectangle", "to_world": slit, "emitter": glow}}
    Ks = np.array([[[4, 0, 2.5], [0, 4, 1.5], [0, 0, 1.0]]])  # a pixel is one unit wide there
    rig = Rig(viewmats=look_at((0, 0, -4), (0, 0, 0), (0, 1, 0))[None], Ks=Ks, width=5, height=3)
    integrators = [{"type": "path", "max_depth": 2}, {"type": "path", "max_depth": 3}]
    found = path_noise(mi, build_scene(scene, mi), rig, integrators, part, seed=0).reshape(2, 3, 5)
    assert np.array_equal(found[0], found[1])  # they share their random numbers
    assert (found[..., [0, 1, 3, 4]] == 0).all()
    assert (found[..., 2] > 0).any() == (part == 1)
    again = path_noise(mi, build_scene(scene, mi), rig, integrators[:1], part, seed=1)
    assert (again.reshape(3, 5)[:, 2] != found[0, :, 2]).any() == (part == 1)


@pytest.mark.usefixtures("jit")
def test_the_noise_of_paths_is_that_of_all_pixels_when_they_are_traced_in_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mi, loaded, rig = inside_a_ball(0.5)
    integrators = [{"type": "path", "max_depth": 6, "rr_depth": 1}]
    whole = path_noise(mi, loaded, rig, integrators, 1.0, seed=0)
    assert whole.shape == (1, 16)
    assert whole.min() > 1e-9
    monkeypatch.setattr(wavefront, "MAX_WAVEFRONT", 5 * 2 * SPP)
    np.testing.assert_allclose(path_noise(mi, loaded, rig, integrators, 1.0, seed=0), whole, rtol=1e-4)


@pytest.mark.usefixtures("jit")
def test_the_noise_of_paths_is_what_many_renders_differ_by() -> None:
    """In a closed room: twice the variance of the mean of 64 samples, over 12 seeds; roulette makes it larger."""
    mi, loaded, rig = inside_a_ball(0.8)
    integrators = [{"type": "path", "max_depth": 6, "rr_depth": start} for start in (1, 7)]
    found = np.stack([path_noise(mi, loaded, rig, integrators, 1.0, seed) for seed in range(12)]).mean((0, 2))
    images = []
    for seed in range(24):
        integrator = mi.load_dict(integrators[0])
        images.append(
            RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator, seed=100 + seed), rig, 0)
            .render(128, None)
            .mean
        )
    # The mean of two sequences of 64 has half the variance of one, and two of them differ by twice that of one.
    assert found[0] == pytest.approx(4 * np.var(images, 0, ddof=1).mean(), rel=0.3)
    assert found[0] > 1.5 * found[1]


def test_the_choice_weighs_noise_against_rays_and_keeps_the_default_in_doubt() -> None:
    rng = np.random.default_rng(0)
    base = rng.exponential(1.0, 3000)
    lengths = np.array([2.0, 4.0, 8.0])
    assert most_efficient(np.stack([base, base, base]), lengths, 0) == 0
    assert most_efficient(np.stack([base, 0.3 * base, 0.3 * base]), lengths, 0) == 1
    assert most_efficient(np.stack([base, base, 0.1 * base]), lengths, 0) == 2
    # As good on average, and told apart by luck alone.
    rivals = np.stack([5 * rng.exponential(1.0, 3000), 2.75 * rng.exponential(1.0, 3000)])
    assert most_efficient(rivals, lengths[:2], 0) == 0


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_a_lead_counts_from_three_standard_errors_whatever_its_unit(scale: float) -> None:
    """Rays are 5 and 9, so that equal work is noise of 9 and 5; the rival's lead of 0.1 has a spread of 1."""
    lengths = np.array([2.0, 4.0])
    for size, chosen in ((898, 0), (902, 1)):  # three standard errors are 3 / sqrt(size), 0.1 at 900
        apart = np.resize([1.0, -1.0], size)
        noise = np.stack([(90.1 + apart) / 5, np.full(size, 90.0) / 9]) * scale
        assert most_efficient(noise, lengths, 0) == chosen
        assert most_efficient(noise[::-1], lengths[::-1], 1) == 1 - chosen
