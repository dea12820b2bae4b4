"""How long a study would take on so many nodes: list scheduling of its tasks, from their predicted times."""

import heapq
from collections.abc import Mapping, Sequence

from novags.testbed.console.memory import available_bytes
from novags.testbed.study.costs import Cost, longest_after
from novags.testbed.study.engines.choice import Engine
from novags.testbed.study.engines.local import MARGIN
from novags.testbed.study.engines.progress import duration
from novags.testbed.study.plan import StudyPlan


def makespan(plan: StudyPlan, seconds: Mapping[str, float], places: int) -> float:
    """Seconds until all tasks are done, the longest chains first, each task as soon as the tasks it needs are done.

    That is Graham's list scheduling, at most 2 - 1 / places times the shortest (SIAM J. Appl. Math. 17, 1969). A task
    occupies one place; moving data costs nothing.

    Args:
        plan: The plan.
        seconds: Of each task.
        places: Tasks at a time.
    """
    longest = longest_after(plan, seconds)
    waiting = {key: len(set(task.needs)) for key, task in plan.tasks.items()}
    users: dict[str, list[str]] = {}
    for key, task in plan.tasks.items():
        for need in dict.fromkeys(task.needs):
            users.setdefault(need, []).append(key)
    ready = [(-longest[key], key) for key, needs in waiting.items() if not needs]
    heapq.heapify(ready)
    running: list[tuple[float, str]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < places:
            _, key = heapq.heappop(ready)
            heapq.heappush(running, (now + seconds[key], key))
        now, key = heapq.heappop(running)
        for user in users.get(key, []):
            waiting[user] -= 1
            if not waiting[user]:
                heapq.heappush(ready, (-longest[user], user))
    return now


def at_least(plan: StudyPlan, seconds: Mapping[str, float], places: int) -> float:
    """Seconds that no schedule can beat: the longest chain, or all work shared evenly."""
    return max(max(longest_after(plan, seconds).values(), default=0.0), sum(seconds.values()) / places)


def simulated(
    plan: StudyPlan, predicted: Mapping[str, Cost], seconds: Mapping[str, float], engine: Engine, nodes: Sequence[int]
) -> list[str]:
    """A table for some numbers of nodes like this machine; no lines for no numbers.

    Args:
        plan: The study.
        predicted: The cost of each task.
        seconds: That are left of each.
        engine: Where the work would be done.
        nodes: The numbers.

    Raises:
        ValueError: If one is below 1.
    """
    if not nodes:
        return []
    if min(nodes) < 1:
        raise ValueError(f"nodes must be >= 1, got {min(nodes)}")
    places, free = engine.places, available_bytes()
    largest = MARGIN * max((cost.memory for key, cost in predicted.items() if seconds[key]), default=0.0)
    side_by_side = max(1, min(places, int(free / max(largest, 1.0))))
    lines = ["", f"  on nodes like this one, {side_by_side} tasks of {said_threads(engine.threads)} at a time"
             + (" (memory holds no more)" if side_by_side < places else "") + "; moving data is not counted",
             f"  {'nodes':>7}{'time':>12}{'at least':>12}{'node-hours':>13}{'busy':>8}"]  # fmt: skip
    work = sum(seconds.values())
    for count in nodes:
        taken = makespan(plan, seconds, count * side_by_side)
        bound = at_least(plan, seconds, count * side_by_side)
        busy = work / (taken * count * side_by_side) if taken else 1.0
        lines.append(f"  {count:>7}{duration(taken):>12}{duration(bound):>12}{count * taken / 3600:>13.2f}{busy:>8.0%}")
    return lines


def said_threads(threads: Mapping[str, int]) -> str:
    """Threads of each kind of task in words."""
    counts = sorted(set(threads.values()))
    if len(counts) == 1:
        return f"{counts[0]} thread{'s' * (counts[0] > 1)}"
    return " and ".join(f"{threads[kind]} ({kind})" for kind in threads) + " threads"
