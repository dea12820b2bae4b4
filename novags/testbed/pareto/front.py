"""The Pareto front: the points that no other one beats in time and error at once."""

from collections.abc import Sequence


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """The points on the front, fastest first; of equal points all.

    A point is off the front if another one is at least as good in both and better in one.

    Args:
        points: (seconds, error) of each.

    Returns:
        Their indices.

    Raises:
        ValueError: If a number is NaN, which has no order.
    """
    if any(value != value for point in points for value in point):
        raise ValueError(f"the points of a front must be numbers, got {list(points)}")
    found: list[int] = []
    least = float("inf")  # error of the points before, which are at least as fast
    for i in sorted(range(len(points)), key=lambda k: points[k]):
        twin = bool(found) and points[found[-1]] == points[i]
        if points[i][1] < least or twin:
            found.append(i)
            least = points[i][1]
    return found


def beaten_by(point: tuple[float, float], others: Sequence[tuple[float, float, float]], sd: float) -> list[int]:
    """The points that beat one beyond doubt: faster, and with an error smaller by two standard deviations or more.

    Args:
        point: (seconds, error).
        others: (seconds, error, standard deviation of the error) of each.
        sd: Standard deviation of the point's own error.
    """
    seconds, error = point
    return [i for i, (s, e, d) in enumerate(others) if s < seconds and error - e > 2 * (sd**2 + d**2) ** 0.5]
