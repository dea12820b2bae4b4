"""Makes the missing results of a study, in this process: making.py SOURCES STUDY STORE SAID.

The sources are taken from the folder SOURCES. A line of JSON in the file SAID for each thing that happens: the folder
of a result (a set, a capture, a run, or the scores of a run), that a stage began to make it, that it is there, that it
failed. A kept result is there without having begun.
"""

import json
import sys
import traceback
from pathlib import Path
from typing import Any


def main() -> None:
    sources, study, store, said = map(Path, sys.argv[1:])
    sys.path.insert(0, str(sources))
    from novags.process import settle

    settle()
    from novags.testbed.console.terminal import Console
    from novags.testbed.ledger import stage
    from novags.testbed.study.cells.grid import read_study
    from novags.testbed.study.entry import Order
    from novags.testbed.study.plan import plan_of
    from novags.testbed.study.steps import make

    assert Path(stage.__file__).is_relative_to(sources)
    current, done = [""], dict[str, dict[str, Any]]()

    def say(**what: str) -> None:
        with said.open("a") as file:
            file.write(json.dumps(what) + "\n")

    original = stage._Stage.make

    def make_again(self: Any, *how: Any) -> Any:  # called once it is decided that it is made
        result = f"{current[0]} scores" if self.name == "score" else current[0]
        say(begun=result)
        record = original(self, *how)
        say(there=result)
        return record

    stage._Stage.make = make_again  # type: ignore[method-assign]
    store.mkdir(parents=True, exist_ok=True)
    console = Console(stream=sys.stderr)
    plan = plan_of(read_study(study), store, console)
    for key, task in plan.tasks.items():  # each after the tasks it needs
        name = task.kind if task.kind != "run" else task.group
        results = [name, f"{name} scores"] if task.kind == "run" else [name]
        for result in results:
            say(result=result, folder=str(task.folder(store)))
        if any(need not in done for need in task.needs):
            continue
        source = plan.tasks[task.needs[0]].folder(store) if task.needs else task.source
        made_of = {need: done[need]["content"] for need in task.needs}
        current[0] = name
        try:
            done[key] = make(Order(task, task.folder(store), source, made_of, 1), console)
        except Exception as error:
            traceback.print_exc()
            say(failed=name, why=f"{type(error).__name__}: {error}"[:300])
            continue
        for result in results:
            say(there=result)
    say(over="")


if __name__ == "__main__":
    main()
