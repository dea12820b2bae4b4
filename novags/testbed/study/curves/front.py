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


Spread = tuple[float, float]  # a mean, and its standard deviation


def beaten_by(point: tuple[Spread, Spread], others: Sequence[tuple[Spread, Spread]]) -> list[int]:
    """The points that beat one beyond doubt: time and error both smaller by more than two standard deviations.

    Args:
        point: (seconds, error), each with the standard deviation of its measurements.
        others: The same of each.
    """
    return [i for i, other in enumerate(others) if all(_below(b, a) for a, b in zip(point, other, strict=True))]


def _below(a: Spread, b: Spread) -> bool:
    return b[0] - a[0] > 2 * (a[1] ** 2 + b[1] ** 2) ** 0.5
