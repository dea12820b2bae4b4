"""The sampler of the wavefronts: Sobol points as SciPy has them, scrambled without losing what makes them good."""

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import qmc

from simscenes.backend import activate
from simscenes.render.sampler import FOURTH, THIRD, direction_numbers, sampler_class

pytestmark = pytest.mark.usefixtures("jit")


def sampler(pixels: Any, index: Any, seed: int = 0) -> Any:
    mi = activate()
    lanes = (mi.UInt32(np.asarray(n, dtype=np.uint32)) for n in np.broadcast_arrays(pixels, index))
    return sampler_class(mi, mi.variant())(*lanes, mi.UInt32(seed))


def set_of_four(pixel: int, count: int, first: int = 0) -> NDArray[np.float64]:
    """Film and first light of the points `first` .. `first + count - 1`, [count,4]."""
    made = sampler(np.full(count, pixel), first + np.arange(count))
    return np.concatenate([np.array(made.next_2d()).T, np.array(made.next_2d()).T], 1).astype(np.float64)


def boxes_hold(points: NDArray[np.float64], each: int) -> bool:
    """Whether all elementary boxes of volume `each` / n hold `each` of these n points [n,d]."""
    n, d = points.shape
    digits = (n // each).bit_length() - 1
    for split in itertools.product(range(digits + 1), repeat=d):
        if sum(split) == digits:
            number = np.zeros(n, dtype=np.int64)
            for axis, bits in enumerate(split):
                number = (number << bits) + (points[:, axis] * 2**bits).astype(np.int64)
            if (np.bincount(number, minlength=n // each) != each).any():
                return False
    return True


def test_direction_numbers_are_those_of_scipy() -> None:
    """The first 256 points of the third and the fourth dimension, and of the first two in the same form."""
    index = np.arange(256)
    columns = [[1 << k for k in range(24)], direction_numbers(1, 0, (1,)), THIRD, FOURTH]
    digits = [np.bitwise_xor.reduce([(index >> k & 1) * c[k] for k in range(8)]) for c in columns]
    ours = np.stack([sum((d >> k & 1) * 2.0 ** -(k + 1) for k in range(24)) for d in digits], 1)
    theirs = qmc.Sobol(4, scramble=False).random(256)  # in the order of a Gray code
    assert np.array_equal(ours[np.lexsort(ours.T)], theirs[np.lexsort(theirs.T)])


@pytest.mark.parametrize("count", [16, 256])
def test_scrambled_sets_of_four_are_as_evenly_spread_as_sobol_points(count: int) -> None:
    """The quality t of SciPy's points, 2^t of which are in every box; and 0 for film and light by themselves."""
    plain = qmc.Sobol(4, scramble=False).random(count)
    t = next(t for t in range(9) if boxes_hold(plain, 2**t))
    for pixel in range(5):
        for first in (0, count, 6 * count):
            points = set_of_four(pixel, count, first)
            assert boxes_hold(points, 2**t)
            assert boxes_hold(points[:, :2], 1)
            assert all(boxes_hold(points[:, [axis]], 1) for axis in range(4))


def test_every_pair_and_every_single_number_is_stratified() -> None:
    """In the order of a path: film, light, lobe, direction, roulette, light, ..."""
    made = sampler(np.full(64, 3), np.arange(64))
    for call in range(14):
        flat = call % 4 in (0, 2) and call > 0
        points = np.array(made.next_1d())[:, None] if flat else np.array(made.next_2d()).T
        assert ((points >= 0) & (points < 1)).all()
        paired = not flat and call % 4 == 1  # the third and the fourth dimension have t = 1
        assert boxes_hold(points.astype(np.float64), 2 if paired else 1), call


def test_sets_sequences_and_seeds_are_independent() -> None:
    """Correlations over 4096 sequences of their 6th point: each has a standard error of 1/64."""
    columns = []
    for seed in (0, 1):
        made = sampler(np.arange(4096), np.full(4096, 5), seed)
        for call in range(10):
            flat = call % 4 in (0, 2) and call > 0
            columns += [np.array(made.next_1d())] if flat else list(np.array(made.next_2d()))
    columns += [np.roll(columns[0], 1), np.roll(columns[0], 64)]  # the pixels beside
    found = np.corrcoef(np.stack(columns)) - np.eye(len(columns))
    assert np.abs(found).max() < 5 / 64
    means = np.array([c.mean() for c in columns])
    assert np.abs(means - 0.5).max() < 5 * np.sqrt(1 / 12 / 4096)
    assert np.array([c.var() for c in columns]) == pytest.approx(1 / 12, rel=0.1)


def test_the_lens_and_what_the_path_draws_are_independent() -> None:
    """Over 4096 sequences: were lens and first light one point, a lens would see a lamp from one side alone."""
    made = sampler(np.arange(4096), np.full(4096, 5))
    columns = [*np.array(made.next_2d()), *np.array(made.next_lens())]
    made.begin_path()
    columns += [*np.array(made.next_2d()), np.array(made.next_1d()), *np.array(made.next_2d())]
    assert np.abs(np.corrcoef(np.stack(columns)) - np.eye(len(columns))).max() < 5 / 64


def test_points_within_a_sequence_do_not_follow_each_other_across_sets() -> None:
    """Film and lobe, say: over 64 points of 256 sequences their correlation is what chance leaves."""
    made = sampler(np.repeat(np.arange(256), 64), np.tile(np.arange(64), 256))
    order = (made.next_2d, made.next_2d, made.next_1d, made.next_2d, made.next_1d)
    film, _light, lobe, direction, roulette = (np.array(draw()) for draw in order)
    columns = [film[0], film[1], lobe, direction[0], roulette]
    found = np.stack([np.corrcoef([c[k * 64 : k * 64 + 64] for c in columns]) for k in range(256)])
    assert np.abs(found.mean(0) - np.eye(5)).max() < 5 / 8 / 16
    assert found.std(0)[np.triu_indices(5, 1)][1:] == pytest.approx(1 / 8, rel=0.5)  # no two of them are always alike


def test_points_of_a_set_lie_in_their_strata_independently() -> None:
    """Halves of 16 strata, over 1024 sequences: correlations have a standard error of 1/32."""
    made = sampler(np.repeat(np.arange(1024), 16), np.tile(np.arange(16), 1024))
    for draw in (made.next_2d, made.next_2d, made.next_1d, made.next_2d, made.next_1d):
        for points in np.array(draw()).reshape(-1, 1024, 16):
            places = np.sort(points, axis=1) * 16 - np.arange(16)
            found = np.corrcoef((places < 0.5).T) - np.eye(16)
            assert np.abs(found).max() < 5 / 32


@pytest.mark.parametrize("count", [64, 100, 256])
def test_smooth_light_converges_as_stratified_samples_do(count: int) -> None:
    """A product over film and light: variance against that of independent samples, over 500 sequences."""
    made = sampler(np.repeat(np.arange(500), count), np.tile(np.arange(count), 500))
    points = np.concatenate([np.array(made.next_2d()), np.array(made.next_2d())]).astype(np.float64)
    values = np.cos(points - 0.3).prod(0).reshape(500, count)
    ratio = values.mean(1).var() / (values.var() / count)
    assert ratio < 0.02
    assert values.mean() == pytest.approx((np.sin(0.7) + np.sin(0.3)) ** 4, abs=5 * values.mean(1).std() / np.sqrt(500))
