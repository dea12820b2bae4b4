"""`novags dataset`: sets and captures of a grid, as a data set."""

from pathlib import Path
from typing import Literal

from novags.commands import shared
from novags.commands.shared import next_, say, writing
from novags.commands.study import check_numbers, engine_of, store_folder
from novags.options import CLUSTER, Cluster, Folder


def dataset(
    file: Folder, *, out: Path, store: str | None = None, engine: Literal["local", "ray"] = "local",
    workers: int | None = None, cluster: Cluster = CLUSTER, push: str | None = None, dry_run: bool = False,
    retry_failed: bool = False, overwrite: bool = False, wait: bool = False,
) -> None:  # fmt: skip
    """Make a synthetic data set: scenes, rigs, cameras and light levels from one file.

    Its cost is shown first. Finished work is kept: the same command again does only the rest.

    Args:
        file: A study file without methods, with a table [dataset]; `novags help studies` shows one.
        out: Folder of the data set; tables and logs of the work are in its folder `making`.
        store: Folder of all sets and captures, shared with studies; `store` beside `out` if not given. Where both lie
            on one disk, the data set links to its files. With --engine ray a folder that all nodes see; no URL.
        engine: Where the work is done: on this machine, or on a Ray cluster that sees the store.
        workers: Processes at a time on this machine; as many as there are cores, or captures, if not given.
        cluster: Of --engine ray.
        push: Send it to the Hugging Face hub as well, hf:OWNER/NAME; only if there is a token (HF_TOKEN).
        dry_run: Only show the captures, the splits, and their cost: time, memory, disk. Nothing is written.
        retry_failed: Try again the captures that failed before.
        overwrite: Replace another data set in the same folder.
        wait: If another process is writing to `out`, wait until it is done instead of refusing.
    """
    from novags.testbed.dataset.file import read_dataset
    from novags.testbed.dataset.forecast import forecast
    from novags.testbed.dataset.make import publish, refuse_foreign, splits
    from novags.testbed.dataset.pushing import push as send
    from novags.testbed.dataset.pushing import repository
    from novags.testbed.study.conduct import conduct
    from novags.testbed.study.plan import plan_of
    from novags.testbed.study.results import CSV, counted
    from novags.testbed.study.session import again, describe, refuse_other

    check_numbers(workers, cluster)
    if push is not None:
        repository(push)
    if store is not None and "://" in store:
        raise ValueError(f"store {store}: a data set is made of the files in its store, so give --store a folder that "
                         "all nodes see, not a URL")  # fmt: skip
    folder, making = store_folder(store, out), out / "making"
    study, config = read_dataset(file)
    divided = splits(study, config)
    plan = plan_of(study, folder, shared.console(), here=engine == "local")
    chosen = engine_of(engine, len(plan.runs), workers, cluster, None)
    if not overwrite:
        refuse_foreign(out, making)
        refuse_other(plan, making)
    said = forecast(plan, config, divided, folder, out, chosen)
    if dry_run:
        say(said)
        return
    with writing(out, wait) as console:
        console.note(said)
        making.mkdir(exist_ok=True)
        if not overwrite and (why := again(plan, making, folder)):
            console.note(f"dataset: made again, {why}")
        describe(plan, making, folder)
        rows = conduct(plan, making, folder, console, chosen, retry_failed=retry_failed)
        states = counted(rows)
        say(f"{len(rows)} captures: {', '.join(f'{count} {state}' for state, count in states.items())}")
        if states.keys() - {"done"}:
            next_(f"look at the reasons in {making / CSV}, then: the same command with --retry-failed")
            raise SystemExit(1)
        say(publish(plan, config, folder, out, console))
        if push is not None:
            say(send(out, push, console))
    next_(f"look at {out / 'README.md'}")
