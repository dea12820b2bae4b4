"""Which worker gets a job, whether memory holds it, and how workers end."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from novags.testbed.study.engines import local
from novags.testbed.study.engines.local import Pool, PoolLimits


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(("free", "given"), [(3e9, ["large"]), (2e9, [])])
def test_a_job_goes_to_the_idle_worker_with_most_memory_which_counts_as_its_own(
    free: float, given: list[str], order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Expectation: 1.2 times 7 GB are needed, of which the worker has 6: it fits 3 GB and not 2."""
    found: list[str] = []

    def worker(name: str, key: str | None, resident: float) -> Any:
        return SimpleNamespace(key=key, resident=resident, give=lambda *_: found.append(name))

    monkeypatch.setattr(local, "available_bytes", lambda: free)
    memory = {"under way": 3e9, "next": 7e9}
    workers = [worker("busy", "under way", 4e9), worker("small", None, 1e9), worker("large", None, 6e9)]
    limits = PoolLimits(3, memory=memory.__getitem__)
    pool = Pool("doing:make", lambda *_: {}, limits, Mock(), workers=workers[::order])
    pool.queue = Mock(ready=lambda: ["next"])
    pool._start_what_fits()
    assert found == given


def test_every_worker_is_asked_to_stop_before_any_is_waited_for() -> None:
    """Each marks how far it is, all within the same few seconds."""
    workers = [Mock() for _ in range(3)]
    calls = Mock()
    for k, worker in enumerate(workers):
        calls.attach_mock(worker, f"w{k}")
    pool = Pool("doing:make", lambda *_: {}, PoolLimits(3), Mock(), workers=list(workers))
    pool._stop()
    asked = [f"w{k}.ask_to_stop" for k in range(3)]
    assert [call[0] for call in calls.mock_calls] == [*asked, *(f"w{k}.stop" for k in range(3))]
    assert pool.workers == []
