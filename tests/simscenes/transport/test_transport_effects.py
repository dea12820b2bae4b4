"""Each effect is decided from its pilots: on pilots made by hand, with the numbers worked out beside them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, orbit_rig
from simscenes.backend import activate
from simscenes.transport import effects
from simscenes.transport.effects import (
    aperture_effect,
    depth_effects,
    media_effects,
    motion_effect,
    roulette_effect,
)
from simscenes.transport.lengths import Lengths
from simscenes.transport.pilot import Pilot

SMALL = orbit_rig(2, 32, 24, 40, radius=3.0)


def pilots(allowed: float = 0.004, backend: str = "llvm_ad", **more: Any) -> Pilot:
    loaded: Any = SimpleNamespace(scene="scene")
    return Pilot("mi", None, loaded, SMALL, backend, allowed, 5, **more)  # type: ignore[arg-type]


def room(albedo: float, media: bool = False, deepest: tuple[int, ...] = (64,)) -> dict[str, Any]:
    """A closed room: of light that starts as 1 - a, a part a comes back from every surface.

    By length where the paths are those over surfaces, else as pictures.
    """
    if media:
        return {
            "images": {("volpath", d, 2): np.full((2, 1, 3, 4, 3), 2 * (1 - albedo**d)) for d in (2, 8, 16, 32, 64)}
        }
    picture = np.full((2, 1, 3, 4, 3), 2 * (1 - albedo))
    return {"by_length": {d: Lengths(np.stack([albedo**k * picture for k in range(d)]), 0.0) for d in deepest}}


@pytest.mark.parametrize(
    ("albedo", "allowed", "depth"), [(0.7, 0.06, 8), (0.7, 0.004, 16), (0.9, 0.04, 32), (0.9, 0.02, 64), (0.7, 0.7, 8)]
)
@pytest.mark.parametrize("media", [False, True])
def test_paths_end_where_what_lies_beyond_is_allowed(albedo: float, allowed: float, depth: int, media: bool) -> None:
    """Beyond d lies a^d of the light; the pilot itself lacks a^64, so that all shares are of 1 - a^64."""
    p = pilots(allowed, **room(albedo, media))
    seen = 1 - albedo**64
    found, (indirect, deep) = depth_effects(p, media, albedo, None)
    assert found == depth
    assert indirect.name == "indirect light"
    assert indirect.contribution == pytest.approx((albedo**2 - albedo**64) / seen)
    assert indirect.on == (allowed < albedo**2)
    assert indirect.bound == deep.bound == allowed
    assert not indirect.forced
    assert indirect.reason == f"{indirect.contribution:.1%} of the light has bounced more than once"
    assert deep.contribution == pytest.approx(albedo**depth / seen)
    found_beyond = 0.0 if depth == 64 else (albedo**depth - albedo**64) / seen
    assert deep.reason == f"max_depth {depth}: beyond it {found_beyond:.2g}..{deep.contribution:.2g}"
    assert (deep.name, deep.on, deep.forced) == ("paths beyond max_depth", False, False)


def test_a_depth_decided_by_hand_is_kept_and_bounded() -> None:
    found, (_, deep) = depth_effects(pilots(**room(0.7)), False, 0.7, 5)
    assert found == 5
    assert deep.forced
    assert deep.contribution == pytest.approx(0.7**5 / (1 - 0.7**64))


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> dict[int, float]:
    """Surfaces that a path meets and its noise, by where roulette starts; to be filled with the noise.

    Pixel by pixel the squared differences are 1 to 24 parts of it.
    """
    told = {2: 2.0, 3: 2.5, 4: 2.75, 5: 3.0, 6: 4.0, 9: 8.0, 10: 8.5}
    noise: dict[int, float] = {}

    def path_lengths(mi: Any, loaded: Any, rig: Rig, depth: int, starts: list[int], seed: int) -> Any:
        assert (rig, depth, seed) == (SMALL, 8, 5)
        return np.array([told[start] for start in starts])

    def path_noise(mi: Any, loaded: Any, rig: Rig, integrators: list[dict[str, Any]], part: float, seed: int) -> Any:
        assert (rig, part, seed) == (SMALL, 0.25, 5)
        assert len({(i["type"], i["max_depth"]) for i in integrators}) == 1
        return np.stack([noise[i["rr_depth"]] * np.arange(1, 25) / 12.5 for i in integrators])

    monkeypatch.setattr(effects, "path_lengths", path_lengths)
    monkeypatch.setattr(effects, "path_noise", path_noise)
    return noise


@pytest.mark.parametrize(
    ("noise", "media", "start", "on", "reason"),
    [  # rays of a path: 5, 6, 7 and 17; with media one surface later: 6, 6.5, 9, 18
        ((4.0, 4.0, 1.0, 0.8), False, 5, True, "meet 3 surfaces instead of 8"),
        ((4.0, 1.0, 1.0, 0.8), False, 3, True, "meet 2.5 surfaces instead of 8"),
        ((1.0, 1.0, 0.9, 0.8), False, 2, True, "meet 2 surfaces instead of 8"),
        ((40.0, 20.0, 10.0, 0.8), False, 3, False, "would save 75% of the surfaces, and cost more in noise"),
        ((4.0, 4.0, 1.0, 0.8), True, 5, True, "meet 4 surfaces instead of 8.5"),
    ],
)
def test_roulette_starts_where_noise_times_rays_is_least(
    noise: tuple[float, ...], media: bool, start: int, on: bool, reason: str, measured: dict[int, float]
) -> None:
    measured.update(zip((2, 3, 5, 9), noise, strict=True))
    found, effect = roulette_effect(pilots(), media, 8, True, scale=4.0)
    assert found == start
    assert (effect.name, effect.on, effect.contribution, effect.bound) == ("Russian roulette", on, 0, 0)
    said = f"from path length {start}: 8 paths side by side {reason}, noise x 1.12; never changes the mean"
    assert effect.reason == (said if on else reason)


@pytest.mark.parametrize(
    ("depth", "measure", "backend"), [(2, True, "llvm_ad"), (8, False, "llvm_ad"), (8, True, "scalar")]
)
@pytest.mark.parametrize(("media", "start"), [(False, 3), (True, 2)])
def test_roulette_starts_where_it_usually_pays_if_not_measured(
    depth: int, measure: bool, backend: str, media: bool, start: int
) -> None:
    found, effect = roulette_effect(pilots(backend=backend), media, depth, measure)
    assert found == start
    assert (effect.on, effect.contribution, effect.bound) == (True, 0, 0)
    assert effect.reason.startswith(f"from path length {start}, not measured")


@pytest.mark.parametrize(("media", "start"), [(False, 3), (True, 2)])
def test_the_usual_start_stays_unless_another_is_clearly_better(
    media: bool, start: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All starts are as noisy and as long on average, but apart in single pixels by luck."""
    luck = np.random.default_rng(0).exponential(1.0, (4, 24))
    monkeypatch.setattr(effects, "path_lengths", lambda *a: np.ones(4))
    monkeypatch.setattr(effects, "path_noise", lambda *a: luck)
    assert roulette_effect(pilots(), media, 8, True)[0] == start


def test_short_paths_offer_fewer_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(effects, "path_lengths", lambda *a: asked.append(a[4]) or np.array([2.0, 2.5, 3.0]))
    monkeypatch.setattr(effects, "path_noise", lambda *a: asked.append(a[3]) or np.ones((3, 24)))
    roulette_effect(pilots(), True, 3, True)
    assert asked[0] == [3, 4, 5]  # volpath starts a surface later than path does for the same number
    assert asked[1] == [{"type": "volpath", "max_depth": 3, "rr_depth": start} for start in (2, 3, 4)]


@pytest.mark.parametrize(
    ("change", "chromatic", "on", "mis"),
    [(0.1, True, True, True), (0.1, False, True, False), (0.003, True, False, False)],
)
def test_media_count_by_what_they_change(
    change: float, chromatic: bool, on: bool, mis: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without fog it is brighter everywhere; one of two media is coloured."""
    monkeypatch.setattr(effects, "media_in", lambda scene, mi: ["grey", "coloured"])
    monkeypatch.setattr(effects, "_is_chromatic", lambda mi, medium: chromatic and medium == "coloured")
    through = np.full((2, 1, 3, 4, 3), 2.0)
    p = pilots(images={("volpath", 8, 2): through, ("path", 8, 2): through * (1 + change)})
    media, colors = media_effects(p)
    assert (media.name, media.on, media.bound) == ("participating media", on, 0.004)
    assert media.contribution == pytest.approx(change)
    assert media.reason == f"2 medium boundaries; ignoring them changes {change:.1%}"
    assert (colors.name, colors.on, colors.contribution, colors.bound) == ("chromatic media", mis, 0, 0)
    assert colors.reason.startswith("extinction differs" if chromatic else "extinction is the same")


def test_without_media_there_is_nothing_to_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effects, "media_in", lambda scene, mi: [])
    monkeypatch.setattr(effects, "screens_before_points", lambda scene, mi: [])
    found = [(e.on, e.contribution, e.bound) for e in media_effects(pilots())]
    assert found == [(False, 0, 0.004), (False, 0, 0)]


def test_a_homogeneous_medium_is_chromatic_by_its_extinction_alone() -> None:
    mi = activate()
    for sigma_t, chromatic in ((0.4, False), ([0.4, 0.4, 0.4], False), ([0.4, 0.4, 0.5], True)):
        given = sigma_t if isinstance(sigma_t, float) else {"type": "rgb", "value": sigma_t}
        albedo = {"type": "rgb", "value": [0.1, 0.5, 0.9]}
        medium = mi.load_dict({"type": "homogeneous", "sigma_t": given, "albedo": albedo})
        assert effects._is_chromatic(mi, medium) == chromatic


def depths(*values: float) -> list[dict[str, Any]]:
    """Two views that show as many points at each of these depths as the other."""
    return [{"Z": np.array([part], np.float32)} for part in (values[::2], values[1::2])]


def test_blur_by_the_lens_is_the_circle_of_confusion_of_all_views() -> None:
    """In the plane of focus at 2 a point at depth z spreads over 2 r |1 - 2/z|; images are 20 times the pilots."""
    focal = SMALL.Ks[0, 0, 0] * 20
    optics = Optics(aperture_radius=0.1, focus_distance=2.0)
    found = aperture_effect(pilots(), depths(4, 4, 4, 4), optics, 20.0)
    assert found.contribution == pytest.approx(0.1 * focal / 2)
    assert (found.name, found.unit, found.bound, found.on) == ("depth of field", "px", 0.5, True)
    assert found.reason == f"circle of confusion {found.contribution:.2g} px (95th percentile)"
    near, far = 0.2 * (2 / 1 - 1) * focal / 2, 0.2 * focal / 2  # a point at depth 1, and the sky
    assert aperture_effect(pilots(), depths(1, 1), optics, 20.0).contribution == pytest.approx(near)
    assert aperture_effect(pilots(), depths(np.inf, np.inf), optics, 20.0).contribution == pytest.approx(far)
    # Of 21 points, in two views, the 20th in order.
    z = np.linspace(2.0, 6.0, 21)
    assert aperture_effect(pilots(), depths(*z), optics, 20.0).contribution == pytest.approx(
        0.2 * (1 - 2 / z[19]) * focal / 2, rel=1e-5
    )


@pytest.mark.parametrize(("pixels", "on"), [(0.45, False), (0.55, True), (0.9, True)])
def test_half_a_pixel_of_blur_is_allowed(pixels: float, on: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    focal = SMALL.Ks[0, 0, 0]
    radius = pixels * 2 / focal  # of a lens that blurs things at 4, in focus at 2, by so much
    found = aperture_effect(pilots(), depths(4, 4), Optics(aperture_radius=radius, focus_distance=2.0), 1.0)
    assert found.contribution == pytest.approx(pixels)
    assert found.on == on
    monkeypatch.setattr(effects, "image_motion", lambda *a: pixels / 4)
    moving, frames = motion_effect([], SMALL, SMALL, Optics(motion=0.3), 4.0, False)
    assert (moving.name, moving.unit, moving.bound, moving.on) == ("motion blur", "px", 0.5, on)
    assert moving.contribution == pytest.approx(pixels)
    assert moving.reason == f"points move {pixels:.2g} px (95th percentile)"
    assert frames == 4


def test_a_pinhole_at_rest_blurs_nothing() -> None:
    alone = Rig(viewmats=SMALL.viewmats[:1], Ks=SMALL.Ks[:1], width=32, height=24)
    lens = aperture_effect(pilots(), [], Optics(), 1.0)
    still = motion_effect([], SMALL, SMALL, Optics(), 1.0, True)
    single = motion_effect([], alone, alone, Optics(motion=0.5), 1.0, True)
    assert still[1] == single[1] == 1
    for effect in (lens, still[0], single[0]):
        assert (effect.on, effect.contribution, effect.bound, effect.unit) == (False, 0, 0.5, "px")


@pytest.mark.parametrize(("pixels", "frames"), [(0.1, 4), (2.0, 4), (2.1, 16), (8.0, 16), (8.1, 64), (99.0, 64)])
def test_a_step_between_poses_is_half_a_pixel_at_most(
    pixels: float, frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up to 64 poses."""
    asked: list[Any] = []
    monkeypatch.setattr(effects, "image_motion", lambda *a: asked.append(a) or pixels / 8)
    assert motion_effect(["views"], SMALL, SMALL, Optics(motion=0.3), 8.0, True)[1] == frames
    assert asked == [(["views"], SMALL, SMALL, 0.3, True)]


def persistent(albedo: float) -> dict[str, Any]:
    """The room with pilots of any depth."""
    return room(albedo, deepest=(64, 256, 1024))


@pytest.mark.parametrize(("albedo", "depth"), [(0.9, 64), (0.96, 256), (0.985, 512), (0.9995, 1024)])
def test_paths_go_as_deep_as_light_persists(albedo: float, depth: int) -> None:
    """Where 1024 is not deep enough, the plan says how much is left."""
    p = pilots(0.004, **persistent(albedo))
    found, (_, deep) = depth_effects(p, False, albedo, None)
    assert found == depth
    left = albedo**depth / (1 - albedo ** {64: 64, 256: 256, 512: 1024, 1024: 1024}[depth])
    assert deep.contribution == pytest.approx(left, rel=1e-6)
    assert (deep.contribution <= 0.004) == (albedo < 0.9995)
    assert p.rms["paths beyond max_depth"] == pytest.approx((left,) * 5, rel=1e-6)


def test_light_that_fades_more_slowly_than_surfaces_allow_is_seen_to_do_so() -> None:
    """At most 0.99 a bounce is assumed, 0.998 is found: what comes after the deepest path is not underestimated."""
    p = pilots(0.001, **persistent(0.998))
    found, (_, deep) = depth_effects(p, False, 0.99, None)
    assert found == 1024
    assert deep.contribution == pytest.approx(0.998**1024 / (1 - 0.998**1024), rel=1e-3)


def test_deep_paths_do_without_roulette() -> None:
    start, effect = roulette_effect(pilots(), True, 128, True)
    assert (start, effect.on) == (2, False)
    assert effect.reason.startswith("light persists to depth 128: roulette would make it rare and bright")


def test_paths_without_any_noise_make_no_ratio_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene whose every path carries the same light, such as one of lamps alone."""
    monkeypatch.setattr(effects, "path_noise", lambda mi, loaded, rig, integrators, *_: np.zeros((len(integrators), 2)))
    monkeypatch.setattr(
        effects, "path_lengths", lambda mi, loaded, rig, depth, starts, seed: np.arange(1.0, len(starts) + 1)
    )
    _, effect = roulette_effect(pilots(base="rgb"), False, 16, True)
    assert "nan" not in effect.reason


@pytest.mark.parametrize("coloured", [0, 1])
def test_any_colour_of_the_extinction_makes_a_medium_chromatic(coloured: int) -> None:
    """A grid of densities, two colours, and what says nothing of the extinction."""
    grey, red = np.full(3, 0.5), np.array([0.9, 0.5, 0.5])
    parts = [grey, grey]
    parts[coloured] = red
    plain: dict[str, Any] = {
        "albedo.value": red, "sigma_t.data": np.linspace(0, 1, 8).reshape(2, 2, 2, 1), "sigma_t.to_world": np.eye(4),
    }  # fmt: skip
    mi: Any = SimpleNamespace(traverse=lambda medium: medium)
    assert not effects._is_chromatic(mi, plain | {"sigma_t.first": grey, "sigma_t.second": grey})
    assert effects._is_chromatic(mi, plain | {"sigma_t.first": parts[0], "sigma_t.second": parts[1]})
    grid = np.stack([np.full((2, 2, 2), share) for share in (0.5, 0.5, 0.6)], -1)
    assert effects._is_chromatic(mi, plain | {"sigma_t.first": grey, "sigma_t.grid": grid})


def test_materials_that_let_light_of_points_pass_are_found_among_others() -> None:
    """A shadow ray of a lamp of some size may be missed: paths find that lamp by chance as well."""
    mi = activate()
    lamp = {"type": "point", "intensity": 1.0}
    mask = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
    shapes = {name: {"type": "sphere", "bsdf": bsdf} for name, bsdf in
              (("a", {"type": "diffuse"}), ("b", mask), ("c", {"type": "thindielectric"}))}  # fmt: skip
    for names in ("abc", "bca", "cab"):
        scene = {"type": "scene", "lamp": lamp, **{f"shape {k}": shapes[name] for k, name in enumerate(names)}}
        assert effects.screens_before_points(mi.load_dict(scene), mi) == ["MaskBSDF", "ThinDielectric"]
    assert effects.screens_before_points(mi.load_dict({"type": "scene", **shapes}), mi) == []
