"""Rows of Gaussians to columns of sixteen and back: every number at its place."""

import numpy as np
import pytest
from numba import njit

from novags.splats.cpu.vectors import transpose as t

ROWS = np.random.default_rng(0).uniform(-1, 1, (40, 4)).astype(np.float32)


@njit
def there_and_back(three, four, columns, back3, back4):
    t.to_columns3(three, 6, columns, 1)
    t.from_columns3(columns, 1, back3, 9)
    t.to_columns4(four, 8, columns, 5)
    t.from_columns4(columns, 5, back4, 4)


def test_sixteen_rows_of_three_or_four_become_columns_and_rows_again() -> None:
    three, four = ROWS[:, :3].ravel(), ROWS.ravel()
    columns, back3, back4 = np.zeros(16 * 9, np.float32), np.zeros(60, np.float32), np.zeros(72, np.float32)
    there_and_back(three, four, columns, back3, back4)
    np.testing.assert_array_equal(columns.reshape(9, 16)[1:4], ROWS[2:18, :3].T)
    np.testing.assert_array_equal(columns.reshape(9, 16)[5:9], ROWS[2:18].T)
    np.testing.assert_array_equal(back3[9:57], three[6:54])
    np.testing.assert_array_equal(back4[4:68], four[8:72])
    assert not back3[:9].any()
    assert not back4[68:].any()


@njit
def turned(source, target):
    t.transpose(source, 2, 20, target, 1, 17)


def test_a_square_of_sixteen_is_transposed_whatever_the_strides() -> None:
    source, target = np.random.default_rng(1).uniform(-1, 1, 400).astype(np.float32), np.zeros(300, np.float32)
    turned(source, target)
    square = np.stack([source[2 + 20 * i : 18 + 20 * i] for i in range(16)])
    found = np.stack([target[1 + 17 * i : 17 + 17 * i] for i in range(16)])
    np.testing.assert_array_equal(found, square.T)


@njit
def gathered(rows, first, count, columns, sums):
    t.gather3(rows, first, count, columns, 2)
    t.add3(columns, 2, first, count, sums)


@pytest.mark.parametrize("count", [16, 5])
def test_so_many_rows_are_gathered_and_added_and_no_others(count: int) -> None:
    columns, sums = np.full(16 * 6, 9.0, np.float32), np.ones((40, 3), np.float32)
    rows = np.ascontiguousarray(ROWS[:, :3])
    gathered(rows, 3, count, columns, sums)
    if count < 16:  # of sixteen the columns may be overwritten
        np.testing.assert_array_equal(columns.reshape(6, 16)[2:5, :count], rows[3 : 3 + count].T)
        assert (columns.reshape(6, 16)[2:5, count:] == 9).all()
    wanted = np.ones((40, 3), np.float32)
    wanted[3 : 3 + count] += rows[3 : 3 + count]
    np.testing.assert_array_equal(sums, wanted)
