"""Three channels, wavelengths or polarisation: what each decision makes of the numbers it is given."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sensor_model.plan import Effect
from simscenes import Optics
from simscenes.backend import activate
from simscenes.camera import camera_color
from simscenes.loading.reference import SceneRef
from simscenes.transport import colors, pilot, spectra
from simscenes.transport.colors import color_effects, polarisation_effect, spectral_effect
from simscenes.transport.lengths import SPECULAR, Lengths
from simscenes.transport.pilot import DEEPEST, Pilot

NIKON = "Nikon 5100 (NPL)"
DIFFUSE, MIRROR = 0x2 | 0x4, 0x20


class Object:
    """Stands in for Mitsuba's objects."""


def lengths(chained: float, light: float = 0.5) -> dict[int, Lengths]:
    """Three times `light` in every pixel, `chained` of it passed on by two specular surfaces."""
    return {DEEPEST: Lengths(np.full((3, 2, 1, 3, 4, 3), light), chained)}


def pilots(scene: Any = None, *, backend: str = "llvm_ad", allowed: float = 0.004, chained: float = 1.5) -> Pilot:
    source = SceneRef.of(scene or {"type": "scene"})
    loaded: Any = SimpleNamespace(scene="scene", rgb_alone=False)
    p = Pilot(SimpleNamespace(Object=Object), source, loaded, None, backend, allowed, 5)  # type: ignore[arg-type]
    p.by_length.update(lengths(chained))
    p.scenes.update(spectral="in spectra", spectral_polarized="polarised")  # type: ignore[arg-type]
    return p


def made_for_rgb(**more: Any) -> Pilot:
    return pilots({"type": "scene", "group": {"type": "shapegroup", "mesh": Object()}}, **more)


@pytest.fixture(autouse=True)
def no_renderer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pilot, "using_variant", lambda backend, color: nullcontext(f"{backend}_{color}"))
    monkeypatch.setattr(colors, "filters_in", lambda scene, mi: [])


@pytest.fixture
def surfaces(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Sets the kinds of the surfaces that a scene has, one after the other."""

    def have(*flags: int) -> None:
        shapes = [SimpleNamespace(bsdf=lambda f=f: SimpleNamespace(flags=lambda: f)) for f in flags]
        monkeypatch.setattr(colors, "unique_materials", lambda scene, mi: shapes)

    return have


def test_glossy_and_mirroring_lobes_are_those_that_polarise() -> None:
    flags = activate().BSDFFlags
    assert SPECULAR == int(flags.All) & ~int(flags.Diffuse) & ~int(flags.Null)


def test_diffuse_surfaces_alone_polarise_nothing(surfaces: Any) -> None:
    surfaces(DIFFUSE, DIFFUSE)
    found = polarisation_effect(pilots(), False, [], True)
    assert (found.name, found.on, found.contribution, found.bound) == ("polarisation", False, 0, 0.004)
    assert "diffuse" in found.reason


@pytest.mark.parametrize(
    "p", [pilots(chained=0.03), made_for_rgb(allowed=1e-9, chained=0.03)], ids=["bounded", "made for RGB"]
)
def test_polarisation_is_bounded_by_the_light_of_two_mirrors_in_a_row(p: Pilot, surfaces: Any) -> None:
    """0.03 of 1.5 comes by two; of that a tenth may change."""
    surfaces(DIFFUSE, MIRROR)
    found = polarisation_effect(p, False, [], False)
    assert not found.on
    assert found.contribution == pytest.approx(0.002)
    assert found.reason == "bounded: 2.0% of the light comes by two specular surfaces in a row"
    p.by_length.update(lengths(0.03, light=0.0))
    assert polarisation_effect(p, False, [], False).contribution == 0


def test_a_scalar_variant_bounds_polarisation_by_the_pixels_that_show_mirrors(surfaces: Any) -> None:
    """Material 0 is the sky; of 12 pixels in two views 3 show material 2."""
    surfaces(DIFFUSE, MIRROR, DIFFUSE)
    views = [{"material": np.array([[0, 1, 2], [2, 3, 0]])}, {"material": np.array([[1, 1, 1], [2, 3, 0]])}]
    found = polarisation_effect(pilots(backend="scalar", allowed=0.05), False, views, False)
    assert (found.on, found.reason) == (False, "bounded: 25.0% of pixels show specular")
    assert found.contribution == pytest.approx(0.025)


@pytest.mark.parametrize(("media", "kind"), [(False, "path"), (True, "volpath")])
@pytest.mark.parametrize(("change", "on"), [(0.1, True), (0.003, False)])
@pytest.mark.parametrize(("measure", "measured_spectra"), [(True, False), (False, True)])
def test_polarisation_is_measured_by_paired_pilots(
    media: bool,
    kind: str,
    change: float,
    on: bool,
    measure: bool,
    measured_spectra: bool,
    surfaces: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On request, and where the bound does not suffice in a scene with spectra of its own."""
    surfaces(MIRROR)
    monkeypatch.setattr(colors, "_has_measured_spectra", lambda p: measured_spectra)
    asked: list[Any] = []

    def rendered(mi: Any, loaded: Any, rig: Any, settings: dict[str, Any], seed: int, spp: int) -> Any:
        asked.append((mi, loaded, settings, seed, spp))
        return np.full((2, 1, 3, 4, 3), 2.0 * (1 + change if loaded == "polarised" else 1))

    monkeypatch.setattr(pilot, "render_pilot", rendered)
    found = polarisation_effect(replace(pilots(), spp=32), media, [], measure)
    assert found.on == on
    assert found.contribution == pytest.approx(change)
    assert found.reason == f"paired pilots with and without differ by {change:.2%}"
    settings = {"type": kind, "max_depth": 8, "rr_depth": 4}
    assert asked == [
        ("llvm_ad_spectral", "in spectra", settings, 5, 32),
        ("llvm_ad_spectral_polarized", "polarised", settings, 5, 32),
    ]


def test_a_short_job_in_rgb_is_not_loaded_in_spectra_for_a_bound(
    surfaces: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three quarters of the light by two mirrors, a tenth of that at most by polarisation: more than allowed."""
    surfaces(MIRROR)
    monkeypatch.setattr(colors, "_has_measured_spectra", lambda p: False)
    monkeypatch.setattr(pilot, "render_pilot", lambda *a: pytest.fail("a pilot in spectra"))
    found = polarisation_effect(pilots(chained=1.125), False, [], False)
    assert not found.on
    assert found.contribution == pytest.approx(0.075)
    assert found.reason.endswith("; it takes made-up spectra, and what these change is not measured")


@pytest.fixture
def cost(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Sets what RGB costs after one and after two reflections."""

    def is_(once: float, twice: float) -> None:
        def told(light: Any, surface: Any, camera: str | None, bounces: int) -> float:
            assert (light, surface) == ("llvm_ad_spectral", "in spectra")
            return (once, twice)[bounces - 1]

        def seen(mi: Any, loaded: Any, rig: Any, seed: int) -> Any:
            assert seed == 5
            return mi, loaded

        monkeypatch.setattr(spectra, "light_and_surface", seen)
        monkeypatch.setattr(spectra, "color_error", told)

    return is_


@pytest.mark.parametrize(
    ("once", "twice", "indirect", "expected"),
    [
        (0.1, 0.3, 0.25, 0.15),
        (0.1, 0.3, 1.5, 0.3),
        (0.1, 0.3, 0.0, 0.1),
        (0.3, 0.1, 0.5, 0.3),
        (0.002, 0.003, 0.5, 0.0025),
    ],
)
def test_measured_spectra_cost_more_where_light_meets_two_surfaces(
    once: float, twice: float, indirect: float, expected: float, cost: Any
) -> None:
    cost(once, twice)
    found, made_up = spectral_effect(pilots("market:3"), Optics(), indirect, True)
    assert found.contribution == pytest.approx(expected)
    assert (found.name, found.on, found.bound, made_up) == ("spectral transport", expected > 0.004, 0.004, None)
    assert found.reason == f"RGB errs by {once:.1%} after one bounce, {twice:.1%} after two"


def test_a_scalar_variant_takes_measured_spectra_for_needed() -> None:
    found, made_up = spectral_effect(pilots("market", backend="scalar"), Optics(), 0.3, True)
    assert (found.on, found.contribution, made_up) == (True, np.inf, None)


def test_objects_made_for_rgb_keep_their_colours() -> None:
    found, made_up = spectral_effect(made_for_rgb(), Optics(camera=NIKON), 0.3, True)
    assert (found.on, found.contribution, found.bound, made_up) == (False, 0, 0.004, None)


@pytest.mark.parametrize("camera", [None, NIKON])
@pytest.mark.parametrize(("measure", "backend"), [(True, "llvm_ad"), (False, "llvm_ad"), (True, "scalar")])
def test_rgb_lights_err_by_the_matrix_of_the_camera(camera: str | None, measure: bool, backend: str, cost: Any) -> None:
    """What made-up spectra would change is told beside it, if it is measured."""
    cost(0.1, 0.3)
    found, made_up = spectral_effect(pilots("cornell", backend=backend), Optics(camera=camera), 0.25, measure)
    matrix = 0.0 if camera is None else camera_color(camera).matrix_error
    assert (found.on, found.contribution) == (False, matrix)
    assert ("ColorChecker" in found.reason) == (camera is not None)
    if measure and backend == "llvm_ad":
        assert made_up == pytest.approx(0.15)
    else:
        assert made_up is None


def test_a_scene_that_is_no_catalogues_is_asked_for_measured_spectra(monkeypatch: pytest.MonkeyPatch) -> None:
    for answer in (True, False):
        asked: list[Any] = []
        monkeypatch.setattr(spectra, "has_measured", lambda *a, asked=asked, answer=answer: asked.append(a) or answer)
        assert colors._has_measured_spectra(pilots()) == answer
        assert asked == [("llvm_ad_spectral", "in spectra")]
        assert colors._has_measured_spectra(pilots("market:2"))
        assert not colors._has_measured_spectra(pilots("cornell"))
        assert len(asked) == 1


def decision(name: str, on: bool, contribution: float = 0.0) -> Effect:
    return Effect(name=name, on=on, forced=False, contribution=contribution, bound=0.004, unit="u", reason="found")


@pytest.mark.parametrize(
    ("spectral", "made_up", "backend", "measured", "then", "told"),
    [
        (False, 0.2, "llvm_ad", False, False, 0.2),
        (False, 0.1, "llvm_ad", False, False, 0.1),  # no better
        (False, 0.05, "llvm_ad", False, True, 0.05),
        (False, None, "llvm_ad", False, False, 0.15),  # measured for this decision
        (True, None, "llvm_ad", False, True, None),
        (False, None, "scalar", False, True, None),
        (False, None, "llvm_ad", True, True, None),
    ],
)
def test_polarisation_is_followed_if_it_changes_more_than_the_spectra_made_up_for_it(
    spectral: bool, made_up: float | None, backend: str, measured: bool, then: bool, told: float | None,
    cost: Any, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """It changes 0.1."""
    cost(0.1, 0.3)
    monkeypatch.setattr(colors, "spectral_effect", lambda *a: (decision("s", spectral), made_up))
    monkeypatch.setattr(colors, "polarisation_effect", lambda *a: decision("p", True, 0.1))
    (polarisation, other), found = color_effects(
        pilots("market" if measured else "cornell", backend=backend), Optics(), False, [], 0.25, True
    )
    assert (polarisation.name, polarisation.on, other.name) == ("p", then, "s")
    assert found == (None if told is None else pytest.approx(told))
    assert polarisation.reason == ("found" if then else f"found; it takes made-up spectra, which change {told:.1%}")


@pytest.mark.parametrize("measured", [True, False])
def test_what_filters_change_is_measured_and_kept_whatever_spectra_change(
    measured: bool, surfaces: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their materials have no lobe that polarises, only one that passes light straight on."""
    surfaces(DIFFUSE, 0x1)
    monkeypatch.setattr(colors, "filters_in", lambda scene, mi: ["LinearPolarizer"])
    monkeypatch.setattr(colors, "spectral_effect", lambda *a: (decision("s", False), 0.9))
    light = {"in spectra": 1.0, "polarised": 1.1}
    monkeypatch.setattr(pilot, "render_pilot", lambda mi, loaded, *a: np.full((2, 1, 3, 4, 3), light[loaded]))
    (found, _), _ = color_effects(pilots(), Optics(), False, [], 0.25, measured)
    assert found.on
    assert found.contribution == pytest.approx(0.1)
    (lost, _), _ = color_effects(made_for_rgb(), Optics(), False, [], 0.25, measured)
    assert (lost.on, lost.contribution) == (False, np.inf)
    assert lost.reason == "the scene holds LinearPolarizer, but also parts made for rgb alone"


def test_what_rgb_cannot_load_is_followed_in_spectra(surfaces: Any) -> None:
    surfaces(MIRROR)
    p = pilots()
    loaded: Any = SimpleNamespace(scene="scene", rgb_alone=False, demand="it needs spectra")
    for base, polarised in (("spectral", False), ("spectral_polarized", True)):
        other = replace(p, base=base, loaded=loaded)
        effect, made_up = spectral_effect(other, Optics(), 0.25, True)
        assert (effect.on, effect.contribution, made_up) == (True, np.inf, None)
        assert effect.reason == "RGB cannot load it: it needs spectra"
        if polarised:
            assert polarisation_effect(other, False, [], True).reason == "nothing less can load it: it needs spectra"


def test_measured_spectra_of_anything_but_matt_surfaces_are_compared_in_pilots(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    p = pilots()
    monkeypatch.setattr(spectra, "has_measured", lambda mi, loaded: True)
    monkeypatch.setattr(spectra, "measured_elsewhere", lambda mi, loaded: ["medium", "transmittance"])
    light = {"in spectra": 1.2}
    monkeypatch.setattr(
        pilot,
        "render_pilot",
        lambda mi, loaded, *a: np.full((2, 1, 3, 4, 3), light.get(loaded, 1.0) if isinstance(loaded, str) else 1.0),
    )
    effect, _ = spectral_effect(p, Optics(), 0.25, False)
    assert effect.on
    assert effect.contribution == pytest.approx(0.2)
    assert effect.reason == (
        "measured spectra as medium, transmittance: paired pilots in RGB and in spectra differ by 20.00%"
    )
