"""One task after another in this process, which shows its progress: the default of `novags run`."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from novags.testbed.console.cores import cores_here
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.store import KINDS
from novags.testbed.study.engines.choice import Work
from novags.testbed.study.engines.processes import TASKS
from novags.testbed.study.engines.queue import Queue
from novags.testbed.study.engines.worker import Outcome, failure, function_at


@dataclass(frozen=True)
class Here:
    """This process.

    Attributes:
        console: Where its stages report.
        places: Tasks at a time.
        errors: The errors of failed tasks.
    """

    console: Console
    places: int = 1
    errors: list[Exception] = field(default_factory=list)

    @property
    def threads(self) -> Mapping[str, int]:
        """All cores."""
        return dict.fromkeys(KINDS, cores_here())

    def run(self, work: Work) -> None:
        """Do all tasks; an error that no input explains ends the work.

        Raises:
            BlockingIOError: If another process is at work on one of them.
            OSError: If the machine cannot go on, because a disk is full, say. Finished work is kept.
        """
        places = {key: place for place, key in enumerate(work.plan.tasks)}
        make, queue = function_at(TASKS), Queue(work.watcher, lambda key: -places[key])
        queue.fill(work.plan.tasks.values(), work.known)
        while queue:
            key = queue.ready()[0]
            order = work.order(key, queue.take(key), self.threads[work.plan.tasks[key].kind])
            work.watcher.started(key)
            try:
                outcome = Outcome("done", make(order, self.console))
            except BlockingIOError:
                raise
            except (ValueError, OSError, MemoryError) as error:
                outcome = failure(error, getattr(error, "stage", ""))
                if outcome.state == "machine":
                    raise
                self.errors.append(error)
            queue.end(key, outcome)
            work.watcher.tick()
