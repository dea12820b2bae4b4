"""The arithmetic of pilots on small images made by hand, against loops and against the formulas of statistics."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, orbit_rig
from simscenes.rigs import intrinsics
from simscenes.transport import pilot
from simscenes.transport.lengths import Lengths
from simscenes.transport.pilot import (
    Pilot,
    Share,
    beyond,
    changed_light,
    missing_light,
    pilot_rig,
    root_mean_squares,
)

RNG = np.random.default_rng(4)


def test_missing_light_is_the_mean_lack_with_three_standard_errors() -> None:
    full, part = RNG.uniform(2, 4, (2, 2, 3, 5, 3)), RNG.uniform(1, 3, (2, 2, 3, 5, 3))
    means = (v.mean(0).reshape(-1, 3) for v in (full, part))
    lacks = [float(sum(f - p) / 3) for f, p in zip(*means, strict=True)]
    mean = sum(lacks) / 30
    error = (sum((x - mean) ** 2 for x in lacks) / 29 / 30) ** 0.5
    total = full.sum() / full.size
    found = missing_light(full, part)
    assert found.estimate == pytest.approx(mean / total)
    assert found.upper == pytest.approx((mean + 3 * error) / total)


def test_missing_light_is_never_negative_and_one_pixel_has_no_spread() -> None:
    full = np.full((2, 1, 1, 1, 3), 4.0)
    assert missing_light(full, full / 4) == Share(0.75, 0.75)
    assert missing_light(full, 2 * full) == Share(0, 0)
    assert missing_light(-full, full) == Share(0, 0)
    noisy = np.array([1.0, 3.0]).reshape(1, 1, 2, 1) * np.ones((2, 1, 1, 2, 3))
    found = missing_light(noisy, noisy + [[[[0.5], [1.5]]]])  # what is cut is brighter, by luck
    assert found.estimate == 0
    assert found.upper == pytest.approx(3 * np.sqrt(0.5 / 2) / 2)


def in_blocks(*values: float) -> np.ndarray:
    """Two halves of a view of four blocks of 4 x 4 pixels, each of one value."""
    blocks = np.repeat(np.repeat(np.array(values).reshape(1, 2, 2), 4, 1), 4, 2)[..., None]
    return np.asarray(blocks * np.ones((2, 1, 1, 1, 3)))


@pytest.mark.parametrize("darkest", [1.0, 0.0])
def test_where_a_change_lies_is_told_by_brightness_each_part_relative_to_its_own_light(darkest: float) -> None:
    """At most: three standard errors of a mean square that is the same in all pixels of a quarter add nothing there."""
    light, change = [8.0, darkest, 4.0, 2.0], [3.0, 0.1, 1.0, 0.4]
    square = np.square(change)
    whole = np.sqrt(square.mean() + 3 * square.std() / np.sqrt(64)) / np.mean(light)
    found = root_mean_squares(in_blocks(*change), in_blocks(*light))
    assert found == pytest.approx((whole, 0.1 / max(darkest, 8e-12), 0.4 / 2, 1 / 4, 3 / 8))


def test_a_black_picture_has_no_change_relative_to_its_light() -> None:
    nothing = in_blocks(0.0, 0.0, 0.0, 0.0)
    assert root_mean_squares(nothing, nothing) == (0.0,) * 5


def test_a_change_that_alternates_from_pixel_to_pixel_or_between_channels_counts_in_full() -> None:
    """Light and shade, or red and blue, that a mean over neighbours or channels would let cancel."""
    sign = np.where(np.indices((32, 32)).sum(0) % 2, 1.0, -1.0)[None, None, ..., None]
    tint = np.array([1.0, 0.0, -1.0])
    for change, wanted in (
        (0.2 * sign * np.ones(3), 0.2),
        (0.2 * tint * np.ones((1, 1, 32, 32, 1)), 0.2 * np.sqrt(2 / 3)),
    ):
        both = change * np.ones((2, 1, 1, 1, 1))
        assert root_mean_squares(both, np.ones((2, 1, 32, 32, 3)))[0] == pytest.approx(wanted)


def test_noise_that_the_halves_do_not_share_is_no_change() -> None:
    noise = np.random.default_rng(0).normal(0, 1, (2, 1, 64, 64, 1)) * np.ones(3)
    whole, *_ = root_mean_squares(noise + 0.5, np.ones((2, 1, 64, 64, 3)))
    assert 0.5 < whole < 0.58  # the square is uncertain by a hundredth of one, three times
    assert whole < np.sqrt(1.25) / 1.8  # as it would be with the noise of either


def test_light_beyond_the_pilots_adds_its_own_limit_to_each_part() -> None:
    parts, later = (0.1, 0.2, 0.3, 0.4, 0.5), (0.01, 0.0, 0.0, 0.0, 0.02)
    found = beyond(Share(0.03, 0.08, parts), Share(0.0, 0.001, later), 1, 0.75)
    assert found.rms == pytest.approx((0.11, 0.2, 0.3, 0.4, 0.52))
    assert found == Share(0.03, pytest.approx(4 * 0.08))


def test_beyond_sums_a_geometric_series() -> None:
    series = sum(0.08 * 0.9 ** (5 * k) for k in range(2000))
    assert beyond(Share(0.03, 0.08), Share(0.0, 0.0), 5, 0.9) == Share(0.03, pytest.approx(series))


@pytest.mark.parametrize("block", [1, 2, 4])
def test_changed_light_is_the_mean_absolute_change_of_blocks(block: int) -> None:
    """Blocks end at the edges of the image and never reach over two views."""
    halves = RNG.uniform(1, 3, (2, 2, 2, 5, 6, 3))
    full, other = halves.mean(1)
    changes, sizes = [], []
    for c in range(2):
        for top in range(0, 5, block):
            for left in range(0, 6, block):
                cut = (c, slice(top, top + block), slice(left, left + block))
                changes.append(abs((other[cut] - full[cut]).sum() / other[cut].size))
                sizes.append(other[cut].size / 3)
    total, spread = full.sum() / full.size, np.std(changes) / len(changes) ** 0.5
    estimate = sum(c * n for c, n in zip(changes, sizes, strict=True)) / sum(sizes)
    found = changed_light(*halves, block)
    assert found.estimate == pytest.approx(estimate / total)
    assert found.upper == pytest.approx((estimate + 3 * spread) / total)
    if block == 4:
        assert changed_light(*halves) == found
    assert changed_light(0 * halves[0], halves[1]) == Share(0, 0)


def test_pilot_views_are_spread_over_the_rig_whatever_its_order() -> None:
    """Sorted by their cameras, the first, the middle and the last one; 64 x 18 pixels become 32 x 9."""
    rig = orbit_rig(7, 64, 18, 50, radius=3.0)
    Ks = rig.Ks.copy()
    Ks[:, :2, 2] += [3, -2]
    rig = Rig(viewmats=rig.viewmats, Ks=Ks, width=64, height=18)
    small = pilot_rig(rig)
    order = sorted(range(7), key=lambda i: [*rig.viewmats[i].ravel(), *rig.Ks[i].ravel()])
    assert (small.width, small.height) == (32, 9)
    assert np.array_equal(small.viewmats, rig.viewmats[[order[0], order[3], order[6]]])
    f = Ks[0, 0, 0]
    assert np.allclose(small.Ks, [[f / 2, 0, 35 / 2], [0, f / 2, 7 / 2], [0, 0, 1]])
    shuffled = RNG.permutation(7)
    again = pilot_rig(Rig(viewmats=rig.viewmats[shuffled], Ks=Ks[shuffled], width=64, height=18))
    assert np.array_equal(again.viewmats, small.viewmats)
    assert len(pilot_rig(Rig(viewmats=rig.viewmats[:2], Ks=Ks[:2], width=64, height=18))) == 2


def test_tall_and_flat_pilots_keep_square_pixels_and_one_row() -> None:
    tall = pilot_rig(Rig(viewmats=np.eye(4)[None], Ks=intrinsics(30, 128, 20)[None], width=30, height=128))
    assert (tall.width, tall.height) == (8, 32)
    assert tall.Ks[0, 0, 0] == pytest.approx(tall.Ks[0, 1, 1]) == pytest.approx(4 / np.tan(np.radians(10)))
    assert np.allclose(tall.Ks[0, :2, 2], [4, 16])
    flat = pilot_rig(Rig(viewmats=np.eye(4)[None], Ks=intrinsics(200, 1, 20)[None], width=200, height=1))
    assert (flat.width, flat.height) == (32, 1)
    assert np.allclose(flat.Ks[0, :2, 2], [16, 0.5])


class Renderer:
    """Stands in for mitsuba: a sample takes 1/1024 s, the first render a minute more, the third is held up for 3 s."""

    def __init__(self, variant: str = "llvm_ad_rgb", bad: float = 1.0) -> None:
        self.variant, self.bad = lambda: variant, bad
        self.now, self.asked = 0.0, list[dict[str, Any]]()

    def load_dict(self, what: dict[str, Any]) -> Any:
        return what

    def render(self, scene: Any, **asked: Any) -> Any:
        self.now += {0: 60.0, 2: 3.0}.get(len(self.asked), 0.0) + asked["spp"] / 1024
        self.asked.append(asked)
        return np.full((8, 16, 4), asked["sensor"]["i"] * self.bad)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.setattr(pilot, "sensor_dict", lambda mi, rig, i, loaded: {"i": i + 1})
    monkeypatch.setattr(pilot, "view_seed", lambda rig, i, seed, number: 100 * i + 10 * number + seed)
    return orbit_rig(4, 16, 8, 40, radius=3.0)


LOADED: Any = SimpleNamespace(scene="scene", name="custom")


def test_pilots_render_every_view_with_the_seed_of_its_camera(rig: Rig) -> None:
    mi = Renderer()
    images = pilot.render_pilot(mi, LOADED, rig, {"type": "path"}, 7)
    assert images.shape == (2, 4, 8, 16, 3)
    assert images[:, :, 0, 0, 0].tolist() == [[1, 2, 3, 4]] * 2
    assert [(a["seed"], a["spp"], a["integrator"]) for a in mi.asked] == [
        (seed, 32, {"type": "path"}) for seed in (7, 107, 207, 307, 17, 117, 217, 317)
    ]
    mi = Renderer()
    pilot.render_pilot(mi, LOADED, rig, {"type": "path"}, 7, 16)
    assert {a["spp"] for a in mi.asked} == {8}
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="'custom' renders to nan"):
            pilot.render_pilot(Renderer(bad=bad), LOADED, rig, {"type": "path"}, 7)


@pytest.mark.parametrize(
    ("views", "width", "height", "spp"),
    [(3, 16, 16, 16), (3, 64, 64, 16), (5, 64, 64, 16), (6, 64, 64, 32), (11, 64, 64, 32), (12, 64, 64, 64),
     (8, 256, 256, 64), (1, 32, 8, 16), (3, 128, 64, 64)],
)  # fmt: skip
def test_a_pilot_takes_four_samples_for_a_pixel_of_the_job_at_most(
    views: int, width: int, height: int, spp: int
) -> None:
    """Rounded down to a power of two, and from 16 to 64: 6 views of 64 x 64 are 98,304 / 3,072 pixels of the pilot."""
    whole = orbit_rig(views, width, height, 40, radius=3.0)
    assert pilot.pilot_spp(whole, pilot.pilot_rig(whole)) == spp


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "cuda_ad_rgb"])
def test_a_sample_is_timed_in_the_middle_view_when_its_kernel_is_compiled(
    variant: str, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the processor's clock, and on a GPU by the wall's. What holds up one of two runs is not counted."""
    mi = Renderer(variant)
    right, wrong = ("perf_counter", "process_time") if "cuda" in variant else ("process_time", "perf_counter")
    monkeypatch.setattr(pilot, "time", SimpleNamespace(**{right: lambda: mi.now, wrong: lambda: -mi.now}))
    found = pilot.seconds_per_sample(mi, LOADED, rig, {"type": "path"}, 7)
    assert [(a["sensor"]["i"], a["spp"]) for a in mi.asked] == [(3, 1), (3, 64), (3, 64)]
    assert [a["seed"] for a in mi.asked] == [217, 847, 847]
    assert found == pytest.approx(1 / (1024 * 16 * 8))


def test_paths_over_surfaces_are_followed_once_for_all_cuts_and_others_rendered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The deeper ones without roulette. Fog, spectra, scalar variants and hidden lamps need a render for each cut."""
    followed: list[Any] = []
    rendered: list[Any] = []

    def by_length(mi: Any, loaded: Any, rig: Any, *settings: int) -> Lengths:
        followed.append(settings)
        return Lengths(np.arange(settings[0], dtype=float).reshape(-1, 1, 1, 1, 1, 1), 0.0)

    monkeypatch.setattr(pilot, "light_by_length", by_length)
    monkeypatch.setattr(pilot, "render_pilot", lambda mi, loaded, rig, *a: rendered.append(a) or np.ones(1))
    p = Pilot(None, None, LOADED, None, "llvm_ad", 0.004, 5, spp=32)  # type: ignore[arg-type]
    assert [p.cut("path", d, 64).item() for d in (1, 3, 64)] == [0, 3, 63 * 32]
    assert p.cut("path", 256, 256).item() == 255 * 128
    assert (followed, rendered) == ([(64, 2, 32, 5), (256, 257, 32, 5)], [])
    others = [("volpath", {}), ("path", {"backend": "scalar"}), ("path", {"base": "spectral"}),
              ("path", {"hide_emitters": True})]  # fmt: skip
    for kind, more in others:
        q = replace(p, **more, images={}, by_length={})
        q.cut(kind, 8, 64)
        q.cut(kind, 128, 256)
        expected = [{"type": kind, "max_depth": d, "rr_depth": start, **q.hiding} for d, start in ((8, 2), (128, 257))]
        assert rendered == [(settings, 5, 32) for settings in expected]
        rendered.clear()
    assert len(followed) == 2


def test_light_by_length_that_is_not_finite_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bad = Lengths(np.array([1.0, np.nan]).reshape(2, 1, 1, 1, 1, 1), 0.0)
    monkeypatch.setattr(pilot, "light_by_length", lambda *a: bad)
    p = Pilot(None, None, LOADED, None, "llvm_ad", 0.004, 5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="'custom' renders to nan"):
        p.cut("path", 1, 64)


def test_a_pilot_renders_each_kind_of_path_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def rendered(mi: Any, loaded: Any, rig: Any, integrator: dict[str, Any], seed: int, spp: int) -> Any:
        asked.append((*integrator.values(), seed, spp))
        return np.full(3, len(asked))

    monkeypatch.setattr(pilot, "render_pilot", rendered)
    p = Pilot(None, None, None, None, "scalar", 0.004, 5, spp=32)  # type: ignore[arg-type]
    assert not p.allow_outside  # unless it is told so, it reads no file outside the folder of the scene
    renders = (("path", 8), ("path", 8, 5), ("path", 8), ("volpath", 8), ("path", 9))
    assert [p.render(*a)[0] for a in renders] == [1, 2, 1, 3, 4]
    assert asked == [("path", 8, 2, 5, 32), ("path", 8, 5, 5, 32), ("volpath", 8, 2, 5, 32), ("path", 9, 2, 5, 32)]
