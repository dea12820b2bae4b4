"""A camera of a few lines of numpy is measured pixel by pixel, and ours has to be the same one: its maps, its darkness.

Its dark frames have what no list of numbers holds: tails, rows, a pattern of rows, pixels that are hot or jump.
"""

import logging
from dataclasses import replace

import numpy as np
import pytest

from sensor_model import DarkFrames, Exposure, Limits, Measured, Sensor, expose, plan_effects, raw_noise
from sensor_model.frame.measured import IN_FRAMES

SHAPE, EXPOSURE = (96, 128), Exposure(time=0.01)
CAMERA = Sensor(gain=2.0, eta=0.5, mu_e_sat=8000.0, black_level=200.0, bits=14, sigma_d=2.0, prnu=0.01, dsnu=1.0,
                dark_current=300.0, cfa=None)  # fmt: skip
NO_LIGHT = np.zeros(SHAPE)


def dark_codes(n: int, seed: int, sigma: float = 2.5, bits: int = 14) -> np.ndarray:
    """Frames without light, [n, h, w]; all have the same pattern."""
    fixed, rng = np.random.default_rng(1), np.random.default_rng([2, seed])
    pattern = 1.5 * fixed.normal(size=SHAPE) + np.where(fixed.random(SHAPE) < 0.002, 150.0, 0.0)
    jumps = np.where(fixed.random(SHAPE) < 0.01, 8.0, 0.0)
    noise = sigma * rng.standard_t(6, (n, *SHAPE)) / np.sqrt(1.5) + jumps * rng.integers(-1, 2, (n, *SHAPE))
    rows = 0.8 * sigma / 2.5 * rng.normal(size=(n, SHAPE[0], 1))
    dn = 200.4 + CAMERA.gain * (pattern + noise + rows)
    return np.clip(np.rint(dn), 0, 2**bits - 1).astype(np.uint16)


def dark(n: int = 40, **camera: float) -> DarkFrames:
    return DarkFrames(codes=dark_codes(n, 0), sensor=replace(CAMERA, **camera))


def captures(frames: DarkFrames, n: int, light: np.ndarray = NO_LIGHT, **how) -> np.ndarray:
    measured = Measured(dark=frames)
    return np.stack([expose(light, frames.described, EXPOSURE, seed=7, view=v, measured=measured, **how).dn
                     for v in range(n)])  # fmt: skip


@pytest.mark.parametrize("sigma", [0.4, 1.0, 2.5])
def test_captures_without_light_look_like_frames_that_were_not_drawn_from(sigma: float) -> None:
    """Mean, variance, variance of the means of rows, and the 99.9 % quantile, of noise from 0.8 DN to 5 DN."""
    frames, fresh = DarkFrames(codes=dark_codes(40, 0, sigma), sensor=CAMERA), dark_codes(40, 1, sigma).astype(float)
    taken = captures(frames, 40).astype(float)
    assert taken.mean() == pytest.approx(fresh.mean(), abs=5 * fresh.std() / 400)
    assert taken.var() == pytest.approx(fresh.var(), rel=0.03)
    rows = [(dn - dn.mean(0)).mean(2).var() for dn in (taken, fresh)]
    assert rows[0] == pytest.approx(rows[1], rel=0.1)  # 3840 rows of one in 40: five standard errors of 40 draws
    near, theirs = (np.quantile(dn - dn.mean(0), 0.999) for dn in (taken, fresh))
    assert near == pytest.approx(theirs, abs=max(1.0, 0.04 * theirs))
    assert np.corrcoef(taken.mean(0).ravel(), fresh.mean(0).ravel())[0, 1] > 0.95  # the same hot pixels


def test_frames_without_noise_are_drawn_as_they_are_and_described_without_noise() -> None:
    """Less than rounding alone makes: no variance is negative, and none is divided by."""
    codes = np.repeat(dark_codes(1, 0), 9, 0)
    frames = DarkFrames(codes=codes, sensor=CAMERA)
    assert (captures(frames, 2) == codes[0]).mean() > 0.999
    assert np.isfinite(frames.variance).all()
    described = frames.described
    assert (described.sigma_d, described.sigma_row, described.sigma_column) == (0.0, 0.0, 0.0)


def test_a_capture_without_light_is_a_dark_frame() -> None:
    """But for voltages at the very edge of a code, which float32 moves over it."""
    frames = dark(5)
    for taken in captures(frames, 6):
        assert min((taken != codes).mean() for codes in frames.codes) < 1e-3


@pytest.mark.parametrize("electrons", [0.0, 3.0, 200.0])
@pytest.mark.parametrize("gain", [2.0, 0.3])
def test_analytic_moments_are_those_of_the_frames_that_are_taken(electrons: float, gain: float) -> None:
    """At 0.3 DN for an electron, two of these never reach the next code unless the frame's own rounding is undone."""
    codes = (200 + np.rint((dark_codes(20, 0) - 200.0) * gain / 2)).astype(np.uint16)
    frames = DarkFrames(codes=codes, sensor=replace(CAMERA, gain=gain, prnu=0.0))
    light = np.full(SHAPE, electrons / CAMERA.eta)
    taken = captures(frames, 300, light).astype(float)
    told = expose(light, frames.described, EXPOSURE, seed=0, view=0, measured=Measured(dark=frames))
    miss = (taken.mean(0) - told.mean_dn) / np.sqrt(told.variance_dn / 300)
    assert abs(miss.mean()) < 5 / np.sqrt(miss.size)
    assert np.abs(miss).max() < 6
    assert taken.var(0, ddof=1).mean() == pytest.approx(told.variance_dn.mean(), rel=0.03)


def test_a_jumping_pixel_has_its_own_variance() -> None:
    frames = dark(200)
    told = expose(NO_LIGHT, frames.described, EXPOSURE, seed=0, view=0, measured=Measured(dark=frames)).variance_dn
    jumps = np.random.default_rng(1)
    jumps.normal(size=SHAPE), jumps.random(SHAPE)
    where = jumps.random(SHAPE) < 0.01
    usual = (2 * 2.5) ** 2 + (2 * 0.8) ** 2
    assert told[~where].mean() == pytest.approx(usual, rel=0.02)
    assert told[where].mean() == pytest.approx(usual + (2 * 8) ** 2 * 2 / 3, rel=0.05)


def test_the_camera_in_numbers_is_that_of_the_frames() -> None:
    """The frames bring their dark current, their hot pixels and 0.4 DN over black; the rest stays the camera's."""
    found = dark().described
    assert found.sigma_d**2 == pytest.approx(2.5**2 + 0.01 * 8**2 * 2 / 3, rel=0.04)
    assert found.sigma_row == pytest.approx(0.8, rel=0.1)
    assert found.dsnu == pytest.approx(np.hypot(1.5, 2.5 / np.sqrt(40)), rel=0.05)
    assert found.rgb_bias == pytest.approx([0.4 + 2 * 150 * 0.002] * 3, abs=0.3)
    assert (found.dark_current, found.defects, found.prnu, found.gain) == (0.0, None, CAMERA.prnu, CAMERA.gain)
    curve = raw_noise(found, EXPOSURE, channels=1)
    fresh = dark_codes(40, 3).astype(float)
    seen = 1.4826 * np.median(np.abs(fresh - np.median(fresh)))
    assert float(curve.variance(curve.black[0])) ** 0.5 == pytest.approx(seen, rel=0.1)


def test_colours_have_their_own_black_level() -> None:
    codes = dark_codes(8, 0)
    codes[:, ::2, ::2] += 6
    found = DarkFrames(codes=codes, sensor=replace(CAMERA, cfa="RGGB")).described
    red, green, blue = found.rgb_bias
    assert red - green == pytest.approx(6, abs=0.5)
    assert blue - green == pytest.approx(0, abs=0.5)
    assert found.dsnu < 2


@pytest.mark.parametrize("light", [0.0, 50.0])
def test_the_fast_chain_and_the_plain_one_take_the_same_frame(light: float) -> None:
    offset, response = (np.random.default_rng(k).normal(k, 0.1, SHAPE).astype(np.float32) for k in (0, 1))
    for measured in (Measured(dark=dark(6), response=response), Measured(offset=offset, response=response)):
        camera = CAMERA if measured.dark is None else measured.dark.described
        both = [expose(np.full(SHAPE, light), camera, EXPOSURE, seed=1, view=2, backend=b, measured=measured).dn
                for b in ("numba", "numpy")]  # fmt: skip
        np.testing.assert_array_equal(*both)


def test_a_frame_is_drawn_by_seed_view_and_number_from_all_there_are() -> None:
    """Each has a code of its own, so that the frame that was drawn can be read off."""
    codes = np.stack([np.full(SHAPE, 190 + 2 * k, np.uint16) for k in range(10)])
    frames = DarkFrames(codes=codes, sensor=CAMERA)

    def drawn(**which: int) -> float:
        one = {"seed": 0, "view": 0} | which
        return float(expose(NO_LIGHT, frames.described, EXPOSURE, measured=Measured(dark=frames), **one).dn.mean())

    assert drawn() == drawn()
    for name in ("seed", "view", "frame"):
        means = {round(drawn(**{name: k})) for k in range(100)}
        assert len(means) == 10, name  # one of ten is missed by 100 draws with a probability of 3e-4


def test_a_crop_is_the_crop_of_the_whole() -> None:
    measured = Measured(dark=dark(6), response=np.random.default_rng(0).normal(1, 0.1, SHAPE).astype(np.float32))
    camera, light = measured.dark.described, np.full(SHAPE, 40.0)
    whole = expose(light, camera, EXPOSURE, seed=3, view=1, measured=measured).dn
    part = expose(light[:30, :40], camera, replace(EXPOSURE, origin=(11, 20)), seed=3, view=1, measured=measured).dn
    np.testing.assert_array_equal(part, whole[11:41, 20:60])
    with pytest.raises(ValueError, match=r"within their \(96, 128\), got \(100, 128\); take smaller pictures"):
        expose(light, camera, replace(EXPOSURE, origin=(4, 0)), seed=3, view=1, measured=measured)


def test_three_chips_draw_a_frame_each() -> None:
    frames = dark(20)
    found = expose(np.zeros((*SHAPE, 3)), frames.described, EXPOSURE, seed=0, view=5, measured=Measured(dark=frames)).dn
    noise = found.astype(float) - frames.codes.mean(0)[..., None]
    assert np.abs(np.corrcoef(noise.reshape(-1, 3).T) - np.eye(3)).max() < 0.1


def test_maps_are_the_pattern_of_the_camera() -> None:
    rng = np.random.default_rng(0)
    offset, response = rng.normal(0, 20, SHAPE).astype(np.float32), rng.normal(1, 0.05, SHAPE).astype(np.float32)
    measured, light = Measured(offset=offset, response=response), np.full(SHAPE, 2000.0)
    dim, lit = (np.mean([expose(x, CAMERA, EXPOSURE, seed=0, view=v, measured=measured).dn for v in range(64)], 0)
                for x in (NO_LIGHT, light))  # fmt: skip
    np.testing.assert_allclose(dim - dim.mean(), 2 * (offset - offset.mean()), atol=6 * 2 * 2.7 / 8)
    np.testing.assert_allclose((lit - dim) / 2000, response, atol=6 * np.sqrt(1000 * 4 + 58) / 8 / 2000)


def test_the_plan_says_what_frames_and_maps_take_the_place_of() -> None:
    """They are not left out even where numbers say that they could be."""
    frames = dark()
    plan = plan_effects(replace(frames.described, sigma_row=0.0), EXPOSURE, [5.0, 500.0], Limits(sd=0.05))
    assert not plan.is_on("row_noise")
    told = Measured(dark=frames, response=np.ones(SHAPE, np.float32)).said(plan)
    assert all(
        told.is_on(name) and "in 40 dark frames, which take its place" in told[name].reason for name in IN_FRAMES
    )
    assert told["photon_shot"] == plan["photon_shot"]
    mapped = Measured(response=np.ones(SHAPE, np.float32)).said(plan)
    assert mapped["prnu"].reason == "by the map of this copy of the camera"
    assert mapped.is_on("prnu")
    assert mapped["dsnu"] == plan["dsnu"]
    light = np.full(SHAPE, 40.0)
    planned, whole = (expose(light, frames.described, EXPOSURE, seed=0, view=0, plan=p, measured=Measured(dark=frames))
                      for p in (told, None))  # fmt: skip
    assert abs(float(planned.dn.mean()) - float(whole.dn.mean())) < 1
    np.testing.assert_array_equal(planned.sensor.sigma_d, whole.sensor.sigma_d)


def test_emva1288_finds_the_gain_and_the_darkness_of_frames_that_were_drawn(emva1288) -> None:
    """Rationale: the package shares no code with us. Two of 200 frames are the same in one of 200 pairs."""
    frames = DarkFrames(codes=dark_codes(200, 0), sensor=replace(CAMERA, prnu=0.01))
    measured = Measured(dark=frames)

    def taken(photons: float, n: int, seed: int) -> list[np.ndarray]:
        light = np.full(SHAPE, photons)
        return [expose(light, frames.described, EXPOSURE, seed=seed, view=0, frame=i, measured=measured).dn
                for i in range(n)]  # fmt: skip

    def temporal(images: list[np.ndarray]) -> dict:
        found = emva1288.routines.get_int_imgs(images)
        return {"sum": found["sum"].sum(), "pvar": found["pvar"].sum(), "dmean": found["dmean"]}

    raw = {"temporal": {}, "spatial": {}, "height": SHAPE[0], "width": SHAPE[1]}
    photons = np.linspace(0.02, 1.08, 24) * 8000 / CAMERA.eta
    for i, p in enumerate(photons):
        raw["temporal"][(i + 1) * 1e6] = {q: temporal(taken(q, 2, 2 * i + (q > 0))) for q in (0.0, p)}
    raw["spatial"][11e6] = {q: emva1288.routines.get_int_imgs(taken(q, 40, 999)) for q in (0.0, photons[10])}
    found = emva1288.Results1288(emva1288.Data1288(raw, loglevel=logging.ERROR).data, loglevel=logging.ERROR)
    assert pytest.approx(CAMERA.gain, rel=0.01) == found.K
    assert pytest.approx(100 * CAMERA.eta, rel=0.01) == found.QE
    told = frames.described
    assert found.sigma_d == pytest.approx(np.hypot(told.sigma_d, told.sigma_row), rel=0.02)
    assert found.PRNU1288 == pytest.approx(1.0, rel=0.03)
    everywhere = np.std(frames.mean)  # EMVA 1288 counts hot pixels
    assert found.DSNU1288 == pytest.approx(everywhere, rel=0.02)


@pytest.mark.parametrize(
    ("change", "camera", "message"),
    [
        (lambda dn: dn[:3], {}, "dark frames must be 4 or more, got 3; take ten or more"),
        (lambda dn: dn[0], {}, r"\[n, h >= 8, w >= 8\], got \(96, 128\)"),
        (lambda dn: dn.astype(np.float32), {}, "integer codes, got dtype"),
        (lambda dn: dn << 4, {"bits": 12}, "at most 4095 by the camera's 12 bits, got .*; they are probably"),
        (lambda dn: dn, {"black_level": 4000.0}, "mean of dark frames over the black level must be from .*another cam"),
        (lambda dn: dn + 3000, {}, "mean of dark frames over the black level .* saw light"),
        (lambda dn: np.maximum(dn, 200) - 200, {"black_level": 0.0}, "dark pixels at 0 DN .*; noise is cut off there"),
    ],
)  # fmt: skip
def test_frames_of_another_camera_are_refused(change, camera: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DarkFrames(codes=change(dark_codes(8, 0)), sensor=replace(CAMERA, **camera))


def test_a_dual_gain_that_is_merged_has_noise_that_the_frames_do_not_show() -> None:
    from sensor_model import DualGain

    merged = DualGain(threshold=500.0, sigma_d=9.0, ratio=4.0)
    with pytest.raises(ValueError, match="dual_gain must be None beside dark frames"):
        dark(dual_gain=merged)


def test_noise_of_frames_at_another_gain_is_kept_in_electrons() -> None:
    frames = DarkFrames(codes=dark_codes(40, 0), sensor=replace(CAMERA, gain=4.0), gain=2.0)
    assert frames.described.sigma_d == pytest.approx(dark().described.sigma_d, rel=1e-9)
    assert frames.described.dsnu == pytest.approx(dark().described.dsnu, rel=1e-9)
    assert captures(frames, 8).std() == pytest.approx(2 * captures(dark(), 8).std(), rel=0.03)
