"""The front beside its definition."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from novags.testbed.study.curves.front import beaten_by, front

number = st.one_of(st.integers(0, 4).map(float), st.floats(0, 1e300))  # small whole numbers: many are equal
clouds = st.lists(st.tuples(number, number), max_size=12)


@given(clouds)
def test_a_point_is_on_the_front_unless_another_is_as_good_in_both_and_better_in_one(
    points: list[tuple[float, float]],
) -> None:
    def beaten(a: tuple[float, float]) -> bool:
        return any(b[0] <= a[0] and b[1] <= a[1] and b != a for b in points)

    found = front(points)
    assert sorted(found) == [i for i, point in enumerate(points) if not beaten(point)]
    assert [points[i] for i in found] == sorted(points[i] for i in found)


def test_equal_points_are_on_the_front_together() -> None:
    assert sorted(front([(1.0, 2.0), (1.0, 2.0), (1.0, 3.0), (2.0, 2.0), (2.0, 1.0)])) == [0, 1, 4]


def test_what_is_no_number_has_no_front() -> None:
    with pytest.raises(ValueError, match="must be numbers"):
        front([(1.0, float("nan"))])


def test_beaten_beyond_doubt_means_faster_and_better_by_two_standard_deviations() -> None:
    # sqrt(0.4^2 + 0.3^2) = 0.5: an error of 5 is beaten by less than 4, a time of 2 by less than 1
    point = ((2.0, 0.4), (5.0, 0.4))
    others = {
        ((0.9, 0.3), (3.9, 0.3)): True,
        ((1.1, 0.3), (3.9, 0.3)): False,
        ((0.9, 0.3), (4.1, 0.3)): False,
        ((0.9, 0.6), (0.0, 0.0)): False,
        ((0.0, 0.0), (3.9, 0.6)): False,
        ((3.0, 0.0), (0.0, 0.0)): False,
        ((0.0, 0.0), (0.0, 0.0)): True,
        point: False,
    }
    assert beaten_by(point, list(others)) == [i for i, beats in enumerate(others.values()) if beats]
    exact = ((2.0, 0.0), (5.0, 0.0))
    assert beaten_by(exact, [exact, ((1.9, 0.0), (5.0, 0.0)), ((1.9, 0.0), (4.9, 0.0))]) == [2]
