"""Claims about the queue of jobs: each waits for all that it needs, and gets the results of all."""

from dataclasses import dataclass
from unittest.mock import Mock

import pytest

from novags.testbed.study.engines.queue import Queue
from novags.testbed.study.engines.worker import Outcome

NEEDS = {"a": (), "b": (), "c": ("a", "b"), "d": ("c", "b", "a"), "e": ()}


@dataclass(frozen=True)
class Job:
    key: str
    needs: tuple[str, ...]


def queue(known: dict[str, Outcome] | None = None) -> Queue:
    found = Queue(Mock(), order=lambda key: float(ord(key)))
    found.fill([Job(key, needs) for key, needs in NEEDS.items()], known or {})
    return found


def done(said: str) -> Outcome:
    return Outcome("done", said, "s")


def test_all_jobs_that_need_nothing_can_start_the_most_urgent_first() -> None:
    assert queue().ready() == ["e", "b", "a"]


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_a_job_starts_after_all_that_it_needs_with_the_results_of_all(order: str) -> None:
    jobs = queue()
    for key in order:
        assert jobs.take(key) == {}
        assert "c" not in jobs.ready()
        jobs.end(key, done(f"of {key}"))
    assert jobs.ready() == ["e", "c"]
    assert jobs.take("c") == {"a": "of a", "b": "of b"}
    jobs.end("c", done("of c"))
    assert jobs.ready() == ["e", "d"]
    assert jobs.take("d") == {"c": "of c", "b": "of b", "a": "of a"}
    assert jobs
    jobs.take("e")
    jobs.end("d", done(""))
    jobs.end("e", done(""))
    assert not jobs


def test_all_that_need_a_failed_job_at_any_depth_are_skipped_for_it() -> None:
    jobs = queue()
    jobs.take("b")
    jobs.end("b", Outcome("failed", "no lamp", "render"))
    assert {key: (one.state, one.cause) for key, one in jobs.outcomes.items()} == {
        "b": ("failed", ""), "c": ("skipped", "b"), "d": ("skipped", "b")
    }  # fmt: skip
    assert jobs.ready() == ["e", "a"]


def test_jobs_that_ended_before_are_not_tried_whichever_they_are() -> None:
    jobs = queue({key: done(f"of {key}") for key in ("a", "b", "e")})
    assert jobs.ready() == ["c"]
    assert jobs.take("c") == {"a": "of a", "b": "of b"}
