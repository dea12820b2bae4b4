"""Every scene of the catalogue can be reconstructed from its default views: framed, textured, varied by its seed."""

import gc
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from simscenes import SCENES, default_rig
from simscenes.backend import activate, backend_of
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.loading.reference import SceneRef
from simscenes.render.geometry import geometry_channels
from simscenes.scenes.parts import textures as t
from simscenes.scenes.parts.sculpture import Stone
from simscenes.scenes.parts.shapes import lathe
from simscenes.transport import pilot
from simscenes.transport.effects import DEEPEST, depth_effects, media_effects
from simscenes.transport.pilot import RR_DEPTH, Pilot

OPEN_SKY = {"courtyard", "street"}


@pytest.fixture(scope="module", params=sorted(SCENES))
def built(request: pytest.FixtureRequest) -> Iterator[tuple[str, Any, LoadedScene]]:
    """One scene after the other: Dr.Jit compiles every material alive into every kernel."""
    mi = activate()
    yield request.param, mi, build_scene(request.param, mi)
    gc.collect()


def test_paths_are_followed_deep_enough_for_the_stated_bound(built: tuple[str, Any, LoadedScene]) -> None:
    """Planned depth against paths to the end, with random numbers that the planner never saw, the same for both."""
    name, mi, loaded = built
    rig = default_rig(name, 3, 24, 24)
    p = Pilot(mi, SceneRef.of(name), loaded, rig, backend_of(), 0.005, 0)
    media = media_effects(p)[0].on
    assert media == (name == "street")
    depth, (_, deep) = depth_effects(p, media, pilot.most_reflected(mi, loaded), None)
    kind = "volpath" if media else "path"
    planned, everything = (
        pilot.render_pilot(mi, loaded, rig, {"type": kind, "max_depth": d, "rr_depth": RR_DEPTH}, seed=77)
        for d in (depth, DEEPEST)
    )
    lacking = (everything - planned).mean(-1).ravel()
    error = lacking.std(ddof=1) / np.sqrt(lacking.size)
    assert lacking.mean() <= deep.contribution * everything.mean() + 5 * error
    if backend_of() == "scalar":
        return  # its samplers run on from path to path, so that a cut changes all that follow: differences are noisy
    assert (everything >= planned - 1e-6 * everything.max()).all()
    assert 0 <= deep.contribution <= 0.005
    assert error < 0.005 * everything.mean()


def test_scene_is_framed_textured_and_repeatable(built: tuple[str, Any, LoadedScene]) -> None:
    name, mi, loaded = built
    rig = default_rig(name, 8, 48, 48)
    views = [geometry_channels(mi, loaded, rig, i) for i in range(8)]
    surface = np.stack([v["id"] > 0 for v in views])
    assert surface.mean() > (0.75 if name in OPEN_SKY else 0.999)
    size = float(np.linalg.norm(np.array(loaded.scene.bbox().extents())))
    assert min(v["Z"].min() for v in views) > 0.02 * size  # no camera inside, or right before, an object
    green = np.stack([v["albedo.G"] for v in views]).reshape(8, 6, 8, 6, 8).swapaxes(2, 3).reshape(-1, 64)
    whole = np.stack([v["id"] for v in views]).reshape(8, 6, 8, 6, 8).swapaxes(2, 3).reshape(-1, 64).min(1) > 0
    flat = green.std(1) < 0.01 * green.mean(1).clip(1e-3)
    if name == "hall":
        assert flat[whole].mean() > 0.2  # its bare wall is what it is for
    else:
        assert flat[whole].mean() < 0.05
    assert SCENES[name].text.count("Hard for:") == 1


@pytest.mark.parametrize("name", [n if n == "cornell" else pytest.param(n, marks=pytest.mark.slow) for n in SCENES])
def test_the_seed_and_nothing_else_varies_a_scene(name: str) -> None:
    mi = activate()
    first = build_scene(name, mi)
    assert build_scene(name, mi).digest == first.digest
    assert build_scene(f"{name}:1", mi).digest != first.digest


def test_a_sculpture_is_turned_enlarged_and_moved_with_its_normals() -> None:
    """By hand: a quarter turn about z takes x to y and y to -x."""
    activate()
    stone = Stone((-0.3, -0.3, 0.0), (0.3, 0.3, 0.5), 0.05)
    stone.add((0.05, 0.02, 0.25), (0.2, 0.1, 0.15))
    plain, moved = stone.mesh(grey(), (0, 0, 0)), stone.mesh(grey(), (1.0, 2.0, 3.0), 90.0, 2.0)
    at, normals = (traversed(plain, name) for name in ("vertex_positions", "vertex_normals"))
    np.testing.assert_allclose([at.min(0), at.max(0)], [(-0.15, -0.08, 0.1), (0.25, 0.12, 0.4)], atol=0.025)
    turned = np.stack([-2 * at[:, 1] + 1, 2 * at[:, 0] + 2, 2 * at[:, 2] + 3], -1)
    np.testing.assert_allclose(traversed(moved, "vertex_positions"), turned, atol=1e-5)
    expected = np.stack([-normals[:, 1], normals[:, 0], normals[:, 2]], -1)
    np.testing.assert_allclose(traversed(moved, "vertex_normals"), expected, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


def test_a_lathe_leans_and_turns_once_with_its_normals() -> None:
    """A quarter turn takes x to y and y to -x; leant by 90 degrees, its axis z points to -y first."""
    activate()
    profile = [(0.1, 0.0), (0.3, 0.2), (0.2, 0.6)]
    plain, moved = lathe(profile, grey()), lathe(profile, grey(), (1.0, 2.0, 3.0), 90.0, tilt=90.0)
    for name, shift in (("vertex_positions", (1.0, 2.0, 3.0)), ("vertex_normals", (0.0, 0.0, 0.0))):
        x, y, z = traversed(plain, name).T
        np.testing.assert_allclose(traversed(moved, name), np.stack([z, x, y], -1) + shift, atol=1e-5)


def grey() -> Any:
    import mitsuba as mi

    return mi.load_dict({"type": "diffuse"})


def traversed(shape: Any, name: str) -> np.ndarray:
    import mitsuba as mi

    return np.array(mi.traverse(shape)[name]).reshape(-1, 3)


@pytest.mark.parametrize("beta", [0.8, 1.2, 1.6])
def test_noise_has_the_spectrum_it_promises(beta: float) -> None:
    """Log-log slope of the amplitude spectrum over 16 draws; the standard error of the fit is about 0.01."""
    rng = np.random.default_rng(0)
    power = np.mean([np.abs(np.fft.rfft2(t.fractal((128, 128), rng, beta=beta))) ** 2 for _ in range(16)], 0)
    radius = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.rfftfreq(128)[None]) * 128
    use = (radius > 2) & (radius < 60)
    slope = np.polyfit(np.log(radius[use]), 0.5 * np.log(power[use]), 1)[0]
    assert slope == pytest.approx(-beta, abs=0.05)


def test_a_texture_that_is_remembered_is_that_of_all_its_arguments() -> None:
    def made(text: str, ink: str = "000000", seed: int = 0) -> bytes:
        return t.lettering((32, 48), np.random.default_rng(seed), text, ink=ink, paper="ffffff").tobytes()

    first = made("A")
    assert made("A") == first
    assert len({first, made("B"), made("A", ink="ff0000"), made("A", seed=1)}) == 4


def test_textures_are_possible_reflectances() -> None:
    rng, shape, colors = np.random.default_rng(3), (48, 64), ("102030", "c08040", "f0f0e0")
    made = [
        t.wood(shape, rng), t.bricks(shape, rng), t.cells(shape, rng, colors=colors), t.marble(shape, rng),
        t.motif(shape, rng, repeats=(2, 3), colors=colors), t.painting(shape, rng, colors=colors),
        t.lettering(shape, rng, "Ab", ink="000000", paper="ffffff"), t.spines(shape, rng, colors=colors),
        t.bordered(t.wood(shape, rng), "ffffff"),
    ]  # fmt: skip
    for texels in made:
        assert texels.shape == (*shape, 3)
        assert texels.dtype == np.float32
        assert 0.02 <= texels.min() <= texels.max() <= 0.85
        assert texels.std() > 0.01


@pytest.mark.parametrize(("shape", "text"), [((90, 240), "H"), ((120, 110), "HOHO"), ((60, 60), "H")])
def test_lettering_is_as_large_as_fits_and_in_the_middle(shape: tuple[int, int], text: str) -> None:
    texels = t.lettering(shape, np.random.default_rng(0), text, ink="000000", paper="ffffff")
    frame = 2 * (min(shape) // 14)
    inside = (slice(frame, -frame), slice(frame, -frame))
    rows, columns = (np.flatnonzero((texels.mean(-1) < 0.3)[inside].any(axis)) + frame for axis in (1, 0))
    middle = (rows[0] + rows[-1] + 1) / 2, (columns[0] + columns[-1] + 1) / 2
    # A letter does not fill the height that its font reserves.
    np.testing.assert_allclose(middle, np.array(shape) / 2, atol=0.12 * min(shape))
    filled = np.ptp(rows) / shape[0], np.ptp(columns) / shape[1]
    assert 0.5 < max(filled) < 0.9
