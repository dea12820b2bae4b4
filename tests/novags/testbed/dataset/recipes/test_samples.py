"""Claims about the samples of each recipe."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.dataset.recipes.dark3r import DARK3R
from novags.testbed.dataset.recipes.denoiser import DENOISER
from novags.testbed.dataset.recipes.feedforward import CONTEXT, FEEDFORWARD, context_of
from novags.testbed.dataset.recipes.packing import half_size, packed
from novags.testbed.dataset.recipes.recipe import Group, groups_of
from novags.testbed.stages.configs.capturing import OwnNoiseConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset
from simscenes.rigs import orbit_rig
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.png import read_codes

MOSAIC, CHIPS = "a7s2-iso6400", "a7s2-iso6400-3chip"


def planned(sensor: str, *electrons: float, width: int = 32, height: int = 24) -> Any:
    """A group of captures before they are made, each with noise of its own."""
    render = RenderConfig(scene="cornell", width=width, height=height)
    captures = [OwnNoiseConfig(sensor=sensor, electrons=light, drawn=k) for k, light in enumerate(electrons)]
    found: Any = [SimpleNamespace(render=render, capture=capture) for capture in captures]
    (group,) = groups_of(found)
    return group


def test_the_forecast_of_pairs_counts_every_byte_of_the_pixels_of_every_capture(mosaic: Group, chips: Group) -> None:
    for group, sensor in ((mosaic, MOSAIC), (chips, CHIPS)):
        plan = planned(sensor, *(level.electrons for level in group.levels))
        arrays = [array for sample in DENOISER.samples(group) for array in sample.arrays.values()]
        found = sum(array.nbytes for array in arrays if array.ndim)
        assert DENOISER.pixel_bytes(plan) * len(group.names) * 24 * 32 == found


def test_a_side_that_is_odd_is_refused_behind_a_mosaic_alone() -> None:
    for odd in ({"width": 33}, {"height": 33}):
        with pytest.raises(ValueError, match="make both even"):
            DENOISER.check(planned(MOSAIC, 1, 1000, **odd))
        DENOISER.check(planned(CHIPS, 1, 1000, **odd))
    DENOISER.check(planned(MOSAIC, 1, 1000))


def test_a_bright_and_a_dark_exposure_need_two_lights_however_many_captures_there_are() -> None:
    DARK3R.check(planned(MOSAIC, 1000, 1))
    with pytest.raises(ValueError, match="two values or more for each scene and camera.* got 20: add a bright one"):
        DARK3R.check(planned(MOSAIC, 20, 20))


def test_pairs_are_the_frames_of_every_capture_and_their_noise_has_the_stated_variance(mosaic: Group) -> None:
    found = list(DENOISER.samples(mosaic))
    assert len({sample.name for sample in found}) == len(found) == 3 * 5
    for k, sample in enumerate(found):
        level, i = mosaic.levels[k // 5], k % 5
        assert (sample.row["electrons"], sample.row["view"]) == (level.electrons, mosaic.names[i])
        assert sample.row["snr_db"] == pytest.approx(level.snr_db, abs=5e-4)
        arrays = sample.arrays
        assert np.array_equal(arrays["noisy"], packed(level.capture.raw(i), "RGGB"))
        assert (arrays["noisy"].dtype, arrays["clean"].dtype) == (np.uint16, np.float32)
        assert (arrays["black"], arrays["white"]) == (512, level.sensor.white_dn)
        assert arrays["gain"] == pytest.approx(level.sensor.gain)
        assert arrays["sigma_d"] == pytest.approx(level.sensor.sigma_d)
    dark = [sample.arrays for sample in found[:10]]  # the bright ones are saturated here and there
    drawn = np.concatenate([((a["noisy"] - a["clean"]) / np.sqrt(a["variance"])).ravel() for a in dark])
    assert drawn.mean() == pytest.approx(0, abs=5 / np.sqrt(drawn.size))
    # The fourth moment of such numbers is 3 for a normal one and at most 1 more for a Poisson one beside read noise.
    assert drawn.var() == pytest.approx(1, abs=5 * np.sqrt(3 / drawn.size))


def test_pairs_of_three_chips_keep_their_size(chips: Group) -> None:
    for i, sample in enumerate(DENOISER.samples(chips)):
        capture = chips.levels[0].capture
        assert sample.arrays["noisy"].shape == (3, 24, 32)
        assert np.array_equal(np.moveaxis(sample.arrays["noisy"], 0, -1), capture.raw(i))
        assert np.array_equal(np.moveaxis(sample.arrays["clean"], 0, -1), capture.truth(i, "clean"))


def test_the_bright_exposure_is_the_brightest_and_black_is_kept_on_both_sides(mosaic: Group) -> None:
    found = list(DARK3R.samples(mosaic))
    assert [sample.name for sample in found] == list(mosaic.names)
    darkest, middle, brightest = mosaic.levels
    for i, sample in enumerate(found):
        arrays = sample.arrays
        assert all(array.dtype == np.float32 for array in arrays.values())
        assert np.array_equal(arrays["bright"], half_size(brightest.capture.raw(i), "RGGB"))
        for k, level in enumerate((darkest, middle)):
            assert np.array_equal(arrays["dark"][k], half_size(level.capture.raw(i), "RGGB"))
        assert arrays["electrons"].tolist() == [1, 20]
        assert arrays["bright_electrons"] == 2000
        assert (arrays["black"], arrays["white"]) == (512, brightest.sensor.white_dn)
        assert arrays["snr_db"] == pytest.approx([darkest.snr_db, middle.snr_db])
        assert arrays["bright_snr_db"] == pytest.approx(brightest.snr_db)
        below = np.mean(arrays["dark"][0] < arrays["black"])
        assert 0.1 < below < 0.5  # of an electron beside 1.2 e- of read noise
        rig = mosaic.views.rig
        assert np.array_equal(arrays["viewmat"], rig.viewmats[i].astype(np.float32))
        assert arrays["K"][:2] == pytest.approx(rig.Ks[i][:2] / 2)
        assert sample.row["electrons"] == "1 20 2000"
        assert [float(value) for value in sample.row["snr_db"].split()] == pytest.approx(
            [level.snr_db for level in mosaic.levels], abs=5e-4
        )


def test_views_hold_every_light_level_the_truth_and_their_context(mosaic: Group) -> None:
    found = list(FEEDFORWARD.samples(mosaic))
    views = mosaic.views
    assert [sample.name for sample in found] == list(views.names)
    depths = [read_exr(views.path / "gt" / f"{name}.exr")[0]["Z"] for name in views.names]
    for i, sample in enumerate(found):
        arrays, row = sample.arrays, sample.row
        for k, level in enumerate(mosaic.levels):
            codes = read_codes(level.capture.path / "images16" / f"{sample.name}.png")
            assert np.array_equal(arrays["dark"][k], np.moveaxis(codes, -1, 0))
            light = (arrays["dark"][k].astype(float) - arrays["black"]) / (arrays["white"] - arrays["black"])
            assert np.moveaxis(light, 0, -1) == pytest.approx(level.capture.linear16(i), abs=1e-6)
        assert np.array_equal(arrays["lit"], np.moveaxis(views.image(i), -1, 0))
        assert np.array_equal(arrays["depth"], depths[i])
        assert arrays["electrons"].tolist() == [1, 20, 2000]
        assert np.array_equal(arrays["viewmat"], views.rig.viewmats[i].astype(np.float32))
        assert np.array_equal(arrays["K"], views.rig.Ks[i].astype(np.float32))
        assert (row["sensor"], row["electrons"]) == ("a7s2-iso6400", "1 20 2000")
        assert row["held_out"] == int(i in views.test_indices)
        assert float(row["near"]) == pytest.approx(min(depth.min() for depth in depths), rel=1e-5)
        assert float(row["far"]) == pytest.approx(max(depth.max() for depth in depths), rel=1e-5)
        assert row["context"].split() == [views.names[j] for j in context_of(views, i, float(np.median(depths)))]


def test_a_single_level_of_light_is_enough_for_views(chips: Group) -> None:
    for sample in FEEDFORWARD.samples(chips):
        assert sample.arrays["dark"].shape == (1, 3, 24, 32)
        assert (sample.row["sensor"], sample.row["electrons"]) == ("a7s2-iso6400-3chip", "5")


def before_it_is_made(views: int = 8, width: int = 64, **capture: Any) -> Preset:
    """A capture before it is made."""
    demo = EXPERIMENTS["demo"]
    render = replace(demo.render, n_views=views, width=width)
    return replace(demo, render=render, capture=replace(demo.capture, sensor="a7s2-iso6400", **capture))


def test_a_group_has_all_captures_of_a_set_by_a_camera_whatever_their_light() -> None:
    drawn = OwnNoiseConfig(sensor="a7s2-iso6400", electrons=20.0, drawn=7)
    group = [before_it_is_made(electrons=electrons) for electrons in (5.0, 50.0)]
    noise = [replace(before_it_is_made(), capture=replace(drawn, drawn=seed)) for seed in (7, 8)]
    others = [
        before_it_is_made(views=9),
        before_it_is_made(width=66),
        before_it_is_made(seed=1),
        before_it_is_made(time=0.1),
    ]
    assert groups_of([*others[:2], *group, *noise, *others[2:]]) == [
        *([one] for one in others[:2]), [*group, *noise], *([one] for one in others[2:])
    ]  # fmt: skip


def some_views(viewmats: np.ndarray, held: tuple[int, ...] = (0,)) -> Any:
    test = set(held)
    return SimpleNamespace(path=Path("set"), names=[f"{i:04d}" for i in range(len(viewmats))],
                           rig=SimpleNamespace(viewmats=viewmats), test_indices=sorted(test),
                           train_indices=[i for i in range(len(viewmats)) if i not in test])  # fmt: skip


def test_context_is_the_nearest_training_views_and_neither_a_held_out_one_nor_the_target() -> None:
    """On a ring, views are as near as their numbers, whichever way round."""
    count = 24
    angles = 2 * np.pi * np.arange(count) / count
    viewmats = np.tile(np.eye(4), (count, 1, 1))
    for k, angle in enumerate(angles):
        c, s = np.cos(angle), np.sin(angle)
        viewmats[k, :3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        viewmats[k, 2, 3] = 3.0  # looks at the origin from a distance of 3
    views = some_views(viewmats, held=(0, 8, 16))
    for i in range(count):
        found = context_of(views, i, 3.0)
        steps = [min((j - i) % count, (i - j) % count) for j in found]
        assert len(found) == CONTEXT
        assert steps == sorted(steps)
        assert not {i, 0, 8, 16} & set(found)
        farthest = [j for j in views.train_indices if j != i and min((j - i) % count, (i - j) % count) < steps[-1]]
        assert set(farthest) <= set(found)


def test_a_camera_that_stands_in_place_but_looks_away_is_far() -> None:
    viewmats = np.tile(np.eye(4), (4, 1, 1))
    viewmats[1, :3, :3] = np.diag([-1.0, 1.0, -1.0])  # looks back
    viewmats[2, 0, 3], viewmats[3, 0, 3] = -0.5, -1.0  # step aside
    assert context_of(some_views(viewmats, held=()), 0, 2.0) == [2, 3, 1]


def test_a_target_without_two_others_is_refused() -> None:
    views = some_views(np.asarray(orbit_rig(3, 24, 24, 60, radius=3).viewmats))
    assert context_of(views, 0, 3.0) == [1, 2] or context_of(views, 0, 3.0) == [2, 1]
    with pytest.raises(ValueError, match="view 0001 must have two other training views as context, got 1"):
        context_of(views, 1, 3.0)
