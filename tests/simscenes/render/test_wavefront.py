"""Samples put where the noise is: the same light, less work, the same bits for the same seed."""

from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig
from simscenes.backend import activate, using_variant
from simscenes.loading.load import LoadedScene, build_scene
from simscenes.render import radiance, wavefront
from simscenes.render.blocks import Blocks, sample_shares
from simscenes.render.passes import Passes
from simscenes.render.radiance import Method, View
from simscenes.render.sensors import sensor_dict
from simscenes.rigs import intrinsics, look_at

pytestmark = pytest.mark.usefixtures("jit")
SIZE = 12


def shiny_corner(mi: Any) -> LoadedScene:
    """A matt plane, a rough mirror ball in one corner of the picture and a small strong lamp: uneven noise."""
    t = mi.ScalarTransform4f()
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.2]}}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": 30.0}}
    scene = {
        "type": "scene",
        "plane": {"type": "rectangle", "to_world": t.scale(4), "bsdf": paint},
        "ball": {"type": "sphere", "center": [0.9, 0, 0.5], "radius": 0.5, "bsdf": {"type": "roughconductor"}},
        "lamp": {"type": "sphere", "center": [0, 1, 2.5], "radius": 0.2, "emitter": lamp},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}},
    }
    return build_scene(scene, mi)


def rig() -> Rig:
    viewmat = look_at((0, -4, 3), (0, 0, 0.2))
    return Rig(viewmats=viewmat[None], Ks=intrinsics(SIZE, SIZE, 45)[None], width=SIZE, height=SIZE)


def view(mi: Any, loaded: LoadedScene, seed: int = 0) -> View:
    integrator = mi.load_dict({"type": "path", "max_depth": 6, "rr_depth": 2})
    return View(Method(mi, mi.variant(), loaded, integrator, seed=seed), rig(), 0)


@pytest.mark.parametrize(("color", "camera"), [("rgb", None), ("spectral", None), ("spectral", "Nikon 5100 (NPL)")])
def test_one_block_in_every_pixel_is_what_mitsuba_renders(color: str, camera: str | None) -> None:
    with using_variant(color=color) as mi:
        loaded = shiny_corner(mi)
        settings = sensor_dict(mi, rig(), 0, loaded, Optics(camera=camera))
        sensor, integrator = mi.load_dict(settings), mi.load_dict({"type": "path", "max_depth": 6, "rr_depth": 2})
        film = np.array(mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=16, seed=5))[..., :3]
        pixels = np.arange(SIZE * SIZE, dtype=np.uint32)
        fresh = mi.load_dict(settings)  # one that mi.render has not prepared
        ((_, blocks),) = wavefront.sample_blocks(mi, loaded.scene, fresh, integrator, pixels, 16, 5)
    assert np.allclose(blocks.reshape(SIZE, SIZE, 3), film, rtol=1e-5, atol=1e-6)


def test_parts_of_a_wavefront_add_up_to_the_same_light(monkeypatch: pytest.MonkeyPatch) -> None:
    mi = activate()
    v = view(mi, shiny_corner(mi))
    pixels = np.repeat(np.arange(SIZE * SIZE, dtype=np.uint32), 16)
    arguments = (mi, v.method.loaded.scene, v.sensors[0], v.method.integrator, pixels, 16, 1)
    ((_, whole),) = wavefront.sample_blocks(*arguments)
    monkeypatch.setattr(wavefront, "MAX_WAVEFRONT", 1000)
    found = list(wavefront.sample_blocks(*arguments))
    assert [part.start for part, _ in found] == list(range(0, len(pixels), 1000 // 16))
    parts = np.concatenate([means for _, means in found])
    assert parts.shape == whole.shape
    spread = np.hypot(*(b.std() / np.sqrt(b.size / 3) for b in (whole, parts)))
    assert abs(parts.mean() - whole.mean()) < 5 * spread
    assert len(np.unique(parts[:, 0])) > 0.9 * len(np.unique(whole[:, 0]))  # no part repeats another's numbers


@pytest.mark.parametrize("sizes", ["one", "several"])
def test_a_render_to_a_target_is_unbiased_and_its_variance_true(sizes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mean over n seeds against an even render of many samples; the spread over seeds against the variances stated."""
    if sizes == "several":
        monkeypatch.setattr(radiance, "SEVERAL_SIZES", 0)
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


@pytest.mark.parametrize("kept", [8, 0])
def test_blocks_add_up_like_numpy(kept: int) -> None:
    """Two passes and 2 or 3 blocks in a pixel: mean of all samples, and each part's own variance."""
    rng = np.random.default_rng(0)
    pilot, images = Passes((1, 2)), rng.normal(5, 1, (2, 1, 2, 3))
    for image in images:
        pilot.add(image)
    blocks, values = Blocks(pilot, kept, np.array([[16, 64]])), rng.normal(5, 0.5, (5, 3))
    assert np.array_equal(blocks.mean(), pilot.mean)
    assert np.array_equal(blocks.variance(), pilot.variance())
    pixels = np.array([1, 0, 1, 0, 1])
    for part in (slice(0, 2), slice(2, 5)):  # in two rounds
        blocks.add(pixels[part], values[part])
    assert blocks.count.tolist() == [[2, 3]]
    assert blocks.spp == pytest.approx(kept + (2 * 16 + 3 * 64) / 2)
    for p, (n, size) in enumerate(((2, 16), (3, 64))):
        mine, w = values[pixels == p], size * n / (size * n + kept)
        assert blocks.mean()[0, p] == pytest.approx((1 - w) * images[:, 0, p].mean(0) + w * mine.mean(0))
        alone = images[:, 0, p].var(0, ddof=1) / 2
        assert blocks.variance()[0, p] == pytest.approx((1 - w) ** 2 * alone + w**2 * mine.var(0, ddof=1) / n)


def test_a_pixel_gets_at_least_two_blocks_and_keeps_what_it_has() -> None:
    blocks, shares = Blocks(Passes((1, 4)), 32, np.full((1, 4), 16)), np.array([[0.4, 0.9, 1.1, 1.7]])
    assert blocks.lacking(70, shares).tolist() == [[2, 2, 3, 5]]  # 28, 63, 77, 119 samples, 32 of them there
    blocks.add(np.repeat(np.arange(4), [0, 2, 5, 1]), np.zeros((8, 3)))
    assert blocks.lacking(70, shares).tolist() == [[2, 0, 0, 4]]


def test_samples_go_where_the_noise_is_and_save_work() -> None:
    mi = activate()
    loaded = shiny_corner(mi)
    uneven = view(mi, loaded).render(None, 0.02)
    even = view(mi, loaded).render(uneven.spp, None)
    assert uneven.error < 0.8 * even.error * np.sqrt(even.spp / uneven.spp)


def test_large_views_have_blocks_as_large_as_two_in_a_pixel_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    mi = activate()
    one = view(mi, shiny_corner(mi))
    shares = np.array([[0.1, 0.5, 1.0, 4.0]])
    assert one._block_sizes(600, shares, even=False).tolist() == [[64] * 4]  # some four and more on average
    monkeypatch.setattr(radiance, "SEVERAL_SIZES", 4 * 600)
    assert one._block_sizes(599, shares, even=False).tolist() == [[64] * 4]
    assert one._block_sizes(600, shares, even=False).tolist() == [[16, 64, 256, 1024]]
    assert one._block_sizes(600, np.ones((1, 4)), even=True).tolist() == [[64] * 4]


def test_the_same_seed_gives_the_same_bits() -> None:
    mi = activate()
    loaded = shiny_corner(mi)
    first, again = (view(mi, loaded).render(None, 0.05) for _ in range(2))
    assert np.array_equal(first.mean, again.mean)
    assert np.array_equal(first.variance, again.variance)
    assert first.spp == again.spp


def test_shares_are_positive_even_out_the_noise_and_average_one() -> None:
    variance = np.full((9, 9), 1e-4)
    variance[4, 4] = 1.0
    shares = sample_shares(variance)
    assert shares.mean() == pytest.approx(1)
    assert shares.argmax() == 40
    assert shares.min() > 0.1
    assert (sample_shares(np.zeros((3, 3))) == 1).all()


def test_rare_light_is_not_lost_where_a_pilot_missed_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pixels of mean 1 (a hundredth of the samples are 100), 400 views, of some 230 samples a pixel each.

    Where the pilot counts beside the samples that it asked for, the mean comes out 3.2 % too low, with a standard error
    of 0.3 %.
    """
    rng = np.random.default_rng(0)

    def sampled(self: View, pixels: Any, size: int) -> Any:
        count = SIZE**2 if pixels is None else len(pixels)
        return np.repeat(rng.binomial(size, 0.01, (count, 1)) * 100 / size, 3, -1)

    monkeypatch.setattr(View, "_pixels", sampled)
    method = Method(None, "llvm_ad_rgb", None, None)  # type: ignore[arg-type]  # nothing is traced
    found = [View(method, rig(), 0)._render_to(0.7, lambda part: None).mean.mean() for _ in range(400)]
    error = np.std(found) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(1, abs=5 * error)
    assert error < 0.005


def test_giving_up_on_a_target_is_said_aloud(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(radiance, "MAX_SPP", 64)
    mi = activate()
    with pytest.warns(UserWarning, match="before the target of 0.0001"):
        result = view(mi, shiny_corner(mi)).render(None, 1e-4)
    assert result.error > 1e-4
