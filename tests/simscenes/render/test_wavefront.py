"""Samples put where the noise is: the same light, less work, the same bits for the same seed."""

import random
import time
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig
from simscenes.backend import activate, using_variant
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.render import radiance, wavefront
from simscenes.render.radiance import RenderedView, RenderMethod
from simscenes.render.sensors import sensor_dict
from simscenes.render.sequences import AROUND, LEAST, Sequences, _shares_around, good_counts, pooled, sample_shares
from simscenes.rigs import intrinsics, look_at

pytestmark = pytest.mark.usefixtures("jit")
SIZE = 12


def shiny_corner(mi: Any, ball: str = "roughconductor") -> LoadedScene:
    """A matt plane, a rough mirror ball in one corner of the picture and a small strong lamp: uneven noise."""
    t = mi.ScalarTransform4f()
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": 30.0}}
    scene = {
        "type": "scene",
        "plane": {"type": "rectangle", "to_world": t.scale(4), "bsdf": paint},
        "ball": {"type": "sphere", "center": [0.9, 0, 0.5], "radius": 0.5, "bsdf": {"type": ball}},
        "lamp": {"type": "sphere", "center": [0, 1, 2.5], "radius": 0.2, "emitter": lamp},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}},
    }
    return build_scene(scene, mi)


def rig(size: int = SIZE) -> Rig:
    viewmat = look_at((0, -4, 3), (0, 0, 0.2))
    return Rig(viewmats=viewmat[None], Ks=intrinsics(size, size, 45)[None], width=size, height=size)


def view(mi: Any, loaded: LoadedScene, seed: int = 0, size: int = SIZE) -> RenderedView:
    integrator = mi.load_dict({"type": "path", "max_depth": 6, "rr_depth": 2})
    return RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator, seed=seed), rig(size), 0)


LENS = Optics(aperture_radius=0.8, focus_distance=3.0)


@pytest.mark.parametrize(
    ("color", "optics"),
    [("rgb", Optics()), ("spectral", Optics()), ("spectral", Optics(camera="Nikon 5100 (NPL)")), ("rgb", LENS),
     ("spectral", LENS)],
)  # fmt: skip
def test_the_light_is_what_mitsuba_renders(color: str, optics: Optics) -> None:
    """Pixel by pixel, 1024 samples each, against the spread between 16 parts of ours."""
    with using_variant(color=color) as mi:
        loaded = shiny_corner(mi, "diffuse")  # whose noise is nearly normal
        settings = sensor_dict(mi, rig(), 0, loaded, optics)
        sensor, integrator = mi.load_dict(settings), mi.load_dict({"type": "path", "max_depth": 6, "rr_depth": 2})
        film = np.array(mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=1024, seed=5))[..., :3]
        fresh = mi.load_dict(settings)  # one that mi.render has not prepared
        each = np.full(SIZE * SIZE, 64)
        parts = np.stack([drawn(mi, loaded.scene, fresh, integrator, 0 * each, each, k) for k in range(16)]) / 64
    own = parts.var(0, ddof=1) / 16
    error = np.sqrt(own + pooled(own.reshape(film.shape)).reshape(own.shape))  # those of Mitsuba's are about as large
    away = (parts.mean(0) - film.reshape(-1, 3)) / (error + 1e-5 * film.max())
    assert np.abs(away).max() < 7  # of 432 values whose variances are themselves estimates
    assert abs((parts.mean(0) - film.reshape(-1, 3)).mean()) < 5 * np.sqrt(3 * (error**2).sum()) / error.size


def drawn(mi: Any, scene: Any, sensor: Any, integrator: Any, first: Any, more: Any, seed: int) -> Any:
    """Sums over the samples of every pixel, [h*w,3], all parts together."""
    parts = list(wavefront.sample_sums(mi, scene, sensor, integrator, first, more, [seed]))
    assert [p.start for p, _ in parts] == [0, *(p.stop for p, _ in parts[:-1])]
    assert parts[-1][0].stop == len(more)
    return np.concatenate([sums[0] for _, sums in parts])


def test_sequences_go_on_whatever_their_wavefronts(monkeypatch: pytest.MonkeyPatch) -> None:
    """At once or in two rounds, in one wavefront or in many: the same samples, none of them twice."""
    mi, rng = activate(), np.random.default_rng(3)
    v = view(mi, shiny_corner(mi))
    arguments = (mi, v.method.loaded.scene, v.sensors[0], v.method.integrator)
    first, more = rng.integers(0, 40, (2, SIZE * SIZE))
    none = 0 * first
    begun, rest = drawn(*arguments, none, first, 1), drawn(*arguments, first, more, 1)
    whole = drawn(*arguments, none, first + more, 1)
    assert np.allclose(begun + rest, whole, rtol=1e-6, atol=1e-6)
    assert (whole[first + more == 0] == 0).all()
    monkeypatch.setattr(wavefront, "MAX_WAVEFRONT", 100)
    assert np.array_equal(drawn(*arguments, first, more, 1), rest)
    some = (first > 0) & (more > 0)
    for other in (begun[some] / first[some, None], drawn(*arguments, first, more, 2)[some] / more[some, None]):
        sky = np.isclose(other, rest[some] / more[some, None]).all(1)
        assert sky.mean() < 0.3


def test_sequences_traced_at_once_are_those_traced_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit, some pixels without a sample, in one wavefront and in many."""
    mi, rng = activate(), np.random.default_rng(4)
    v = view(mi, shiny_corner(mi))
    first, more = rng.integers(0, 9, (2, SIZE * SIZE))
    arguments = (mi, v.method.loaded.scene, v.sensors[0], v.method.integrator, first, more)
    each = [drawn(*arguments, seed) for seed in (7, 2**32 - 1, 8)]
    assert not np.array_equal(each[0], each[2])
    for size in (wavefront.MAX_WAVEFRONT, 100):
        monkeypatch.setattr(wavefront, "MAX_WAVEFRONT", size)
        parts = list(wavefront.sample_sums(*arguments, [7, 2**32 - 1, 8]))
        assert np.array_equal(np.concatenate([sums for _, sums in parts], axis=1), each)
        assert max(3 * more[pixels].sum() for pixels, _ in parts) <= size


def test_compiling_is_told_apart_from_tracing() -> None:
    """A kernel with a constant that no kernel had before, then the same one again."""
    import drjit as dr

    mi, constant = activate(), random.SystemRandom().random()
    for new in (True, False):
        start = time.perf_counter()
        with wavefront.compilation() as seconds:
            dr.eval(dr.sin(dr.arange(mi.Float, 999) * constant))
            assert (seconds() > 0) == new
        assert seconds() < time.perf_counter() - start
    assert not dr.flag(dr.JitFlag.KernelHistory)


def test_a_render_to_a_target_is_unbiased_and_its_variance_true() -> None:
    """Mean over n seeds against an even render of many samples; the spread over seeds against the variances stated."""
    mi = activate()
    loaded, n = shiny_corner(mi), 16
    runs = [view(mi, loaded, seed).render(None, 0.03) for seed in range(n)]
    exact = view(mi, loaded, 99).render(4096, None)
    means = np.stack([r.mean for r in runs]).astype(np.float64)
    truth, v = exact.mean.astype(np.float64), exact.variance.astype(np.float64)
    true = means.var(0, ddof=1)
    noisy = true > 1e-9  # the sky is the same in every sample
    pixel = ((means.mean(0) - truth) / np.sqrt(true / n + v).clip(1e-12))[noisy]
    error = np.sqrt(3 * (true / n + v).sum()) / truth.size  # the channels of a pixel err together
    assert abs((means.mean(0) - truth).mean()) < 5 * error
    assert error < 0.005 * truth.mean()
    assert np.abs(pixel).max() < 7  # normal to some 5, but for the noise of `true` itself from 16 runs
    stated = np.array([r.variance.mean() for r in runs])
    assert stated.mean() == pytest.approx(true.mean(), rel=5 * np.sqrt(2 / (n - 1) / 10))  # some 10 pixels dominate
    assert all(r.error <= 0.03 for r in runs)


@pytest.mark.parametrize("width", AROUND)
def test_a_pixel_that_alone_is_noisy_leaves_all_shares_finite(width: float) -> None:
    """Its neighbours' variance is its own taken from a sum of nothing else: rounding errors of either sign."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        variance = np.zeros((24, 24))
        variance[tuple(rng.integers(24, size=2))] = rng.uniform(0.1, 9)
        assert np.isfinite(_shares_around(variance, width)).all()


def test_sequences_add_up_like_numpy() -> None:
    """Halves of 2 and 5 samples in two pixels: the mean of all, and half the difference as its error."""
    rng = np.random.default_rng(0)
    values = [rng.normal(5, 1, (2, n, 3)) for n in (2, 5)]
    made = Sequences((1, 2))
    for p, samples in enumerate(values):
        made.count[0, p] = samples.shape[1]
        made.sums[:, 0, p] = samples.sum(1)
    assert made.spp == 7
    for p, samples in enumerate(values):
        halves = samples.mean(1)
        assert made.mean()[0, p] == pytest.approx(samples.reshape(-1, 3).mean(0))
        assert made.variance()[0, p] == pytest.approx(halves.var(0, ddof=1) / 2)
    assert made.error() == pytest.approx(np.sqrt(made.variance().mean()) / made.mean().mean())


@pytest.mark.parametrize(("whole", "each"), [(1, 35), (4, 36), (16, 48)])
def test_pixels_get_what_they_lack_and_keep_what_they_have(whole: int, each: int) -> None:
    """70 samples are 35 in each half, in whole multiples; what is there already is not drawn again."""
    made = Sequences((1, 4), whole)
    assert made.even(70).tolist() == [[each] * 4]
    assert made.even(0.1).tolist() == [[whole] * 4]
    made.count[:] = [[0, 16, 32, 64]]
    assert made.even(70).tolist() == [[each, each - 16, each - 32, 0]]


def test_shares_are_met_by_counts_that_keep_sobol_points_even() -> None:
    """100 samples at these shares are 5, 20, 40 and 135 in each half, and become 4 (or 6), 24, 48 and 128."""
    made, shares = Sequences((1, 4)), np.array([[0.1, 0.4, 0.8, 2.7]])
    assert made.lacking(100, shares).tolist() == [[6, 24, 48, 128]]
    made.count[:] = [[1, 30, 32, 64]]
    assert made.lacking(100, shares).tolist() == [[5, 0, 16, 64]]
    assert Sequences((1, 4), whole=5).lacking(100, shares).tolist() == [[5, 20, 40, 120]]  # of 1, 4, 8, 27 in five
    counts = np.arange(1, 5000)
    found = good_counts(counts.astype(float))
    odd = found // (found & -found)
    assert set(odd) == {1, 3}
    assert np.abs(np.log(found / counts)).max() <= np.log(1.5) / 2 + 1e-9
    assert (np.diff(found) >= 0).all()
    assert good_counts(np.array([0.0, 0.3])).tolist() == [1, 1]


def test_samples_go_where_the_noise_is_and_save_work() -> None:
    mi = activate()
    loaded = shiny_corner(mi)
    uneven = view(mi, loaded, size=40).render(None, 0.03)
    even = view(mi, loaded, size=40).render(uneven.spp, None)
    assert uneven.error < 0.8 * even.error * np.sqrt(even.spp / uneven.spp)


def test_the_same_seed_gives_the_same_bits() -> None:
    mi = activate()
    loaded = shiny_corner(mi)
    first, again = (view(mi, loaded).render(None, 0.05) for _ in range(2))
    assert np.array_equal(first.mean, again.mean)
    assert np.array_equal(first.variance, again.variance)
    assert first.spp == again.spp


def test_shares_follow_the_deviation_around_a_pixel_but_not_its_own() -> None:
    variance = np.random.default_rng(0).gamma(1.0, 1.0, (31, 31))
    variance[:, 16:] *= 9
    shares = sample_shares(variance)
    assert shares.mean() == pytest.approx(1)
    assert shares[:, 22:].mean() == pytest.approx(3 * shares[:, :9].mean(), rel=0.1)
    own = variance.copy()
    own[15, 7] *= 20
    moved = _shares_around(own, 2.0) / _shares_around(variance, 2.0)
    assert moved[15, 7] == pytest.approx(moved[0, 30])  # but for the total, which all share
    assert moved[15, 8] > 1.2 * moved[15, 7]


def test_shares_are_even_where_neighbours_say_nothing() -> None:
    """One pixel alone with all the noise: to sample those around it would cost the others theirs."""
    variance = np.full((15, 15), 1.0)
    variance[7, 7] = 1e5
    assert (sample_shares(variance) == 1).all()
    variance[6:9, 6:9] = 1e5
    shares = sample_shares(variance)
    assert (variance / shares).mean() < 0.3 * variance.mean()
    assert shares[6:9, 6:9].min() > 3


def test_shares_have_a_least_and_need_no_noise() -> None:
    variance = np.full((32, 32), 1e-9)
    variance[4:8, 4:8] = 1.0
    assert sample_shares(variance).min() == pytest.approx(LEAST, rel=0.3)
    assert sample_shares(variance).min() > 0
    assert (sample_shares(np.zeros((3, 3))) == 1).all()
    assert (sample_shares(np.ones((1, 1))) == 1).all()


def test_rare_light_is_not_lost_where_a_pilot_missed_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels of mean 1 (a hundredth of the samples are 100), 400 views, of some 230 samples a pixel each.

    Where a pixel's own pilot has a say in how many it gets, the mean comes out some per cent too low.
    """
    rng = np.random.default_rng(0)

    def sampled(self: RenderedView, sensor: Any, first: Any, more: Any, frame: int) -> Any:
        for half in range(2):
            found = np.repeat(rng.binomial(more, 0.01)[:, None] * 100.0, 3, -1)
            yield slice(half, half + 1), slice(0, len(more)), found

    monkeypatch.setattr(RenderedView, "_light", sampled)
    monkeypatch.setattr(RenderedView, "sensors", [None])
    method = RenderMethod(None, "llvm_ad_rgb", None, None)  # type: ignore[arg-type]  # nothing is traced
    found = [RenderedView(method, rig(), 0).render(None, 0.7).mean.mean() for _ in range(400)]
    error = np.std(found) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(1, abs=5 * error)
    assert error < 0.005


def test_giving_up_on_a_target_is_said_aloud(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(radiance, "MAX_SPP", 256)
    mi = activate()
    with pytest.warns(UserWarning, match="before the target of 0.0001") as warned:
        result = view(mi, shiny_corner(mi)).render(None, 1e-4)
    assert result.error > 1e-4
    # All that is allowed is drawn, however far away the target is; counts of pixels are rounded to good ones.
    assert 0.7 * 256 < result.spp < 1.4 * 256
    assert f"after {result.spp} samples" in str(warned[0].message)
