"""`novags study`: a grid of runs."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

from novags.commands import shared
from novags.commands.shared import next_, say, writing
from novags.options import CLUSTER, Cluster, Folder

if TYPE_CHECKING:
    from novags.testbed.study.engines.choice import Engine
    from novags.testbed.study.engines.processes import Worker
    from novags.testbed.study.plan import StudyPlan


def study(
    file: Folder, *, out: Path, store: str | None = None, engine: Literal["local", "ray"] = "local",
    workers: int | None = None, cluster: Cluster = CLUSTER, dry_run: bool = False, nodes: tuple[int, ...] = (),
    data: Path | None = None, retry_failed: bool = False, overwrite: bool = False, wait: bool = False,
) -> None:  # fmt: skip
    """Run a grid of scenes, cameras, light levels, methods and seeds from one file; see docs/studies.md.

    Stages that runs share are done once. Finished work is kept: the same command again does only the rest. A run that
    fails becomes a row with its reason, and the rest goes on.

    Args:
        file: The study, a TOML file.
        out: Folder of its tables and logs.
        store: Folder of all sets, captures and runs, which studies share; `store` beside `out` if not given. With
            --engine ray a folder that all nodes see, or a URL for fsspec.
        engine: Where the work is done: on this machine, or on a Ray cluster (docs/clusters.md).
        workers: Processes at a time on this machine; all cores are divided among them. As many as there are cores, or
            runs, if not given.
        cluster: Of --engine ray.
        dry_run: Only show the runs, and their cost: time, memory, disk. Nothing is written.
        nodes: With --dry-run: how long it would take on so many machines like this one; several numbers.
        data: Folder below which the published data sets are whose scenes the file names (docs/real-data.md).
        retry_failed: Try again the runs that failed before.
        overwrite: Replace tables of another study.
        wait: If another process is writing to `out`, wait until it is done instead of refusing.
    """
    from novags.testbed.study.engines.processes import started_ahead
    from sensor_model.files.toml_file import read_toml

    check_numbers(workers, cluster, nodes)
    if nodes and not dry_run:
        raise ValueError("nodes are simulated: add --dry-run")

    with ExitStack() as stack:
        ahead = stack.enter_context(started_ahead(workers)) if engine == "local" and not dry_run else []
        read_toml(file)  # says at once if it cannot be parsed; the next modules take seconds to load
        from novags.testbed.study.curves.measuring import read_any
        from novags.testbed.study.plan import plan_of

        url = store if store is not None and "://" in store else None
        folder = out / "fetched" if url else store_folder(store, out)
        console = shared.console()
        grid = read_any(file, data)
        for name in grid.absent:
            console.warn(f"{name} is not below {data}: no runs of it")
        plan = plan_of(grid, folder, console, here=engine == "local")
        if url and (found := next((task.source for task in plan.tasks.values() if task.source), None)):
            raise ValueError(f"store {url}: the set {found} lies outside it: captures refer to their set by its place, "
                             "so give --store a folder that all nodes see")  # fmt: skip
        chosen = engine_of(engine, len(plan.runs), workers, cluster, url, ahead)
        if grid.ends == "measurement":
            chosen = _whole(chosen, ahead)
        if dry_run:
            say(_forecast(plan, folder, chosen, url, nodes))
            return
        _conduct(plan, out, folder, chosen, url, retry_failed, overwrite, wait)


def check_numbers(workers: int | None, cluster: Cluster, nodes: tuple[int, ...] = ()) -> None:
    """Refuse numbers of processes and machines that nobody has, before any is started.

    Raises:
        ValueError: If there is one; names the option.
    """
    from novags.numbers import check_range
    from novags.testbed.study.engines.needs import read_needs

    read_needs(cluster.needs)
    check_range("workers", 1 if workers is None else workers, 1, 4096)
    check_range("retries", cluster.retries, 0, 1000)
    for count in nodes:
        check_range("nodes", count, 1, 100_000)


def store_folder(store: str | None, out: Path) -> Path:
    """The folder of a local store: the given one, else `store` beside `out`.

    Raises:
        NotADirectoryError: If it is a file.
    """
    folder = out.parent / "store" if store is None else Path(store)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"the store {folder} is a file, not a folder: choose another one")
    return folder


def engine_of(
    name: str, runs: int, workers: int | None, cluster: Cluster, url: str | None, ahead: "Sequence[Worker]" = ()
) -> "Engine":
    """Where the work is done; `ahead`: workers that have been started already.

    Raises:
        ValueError: If options do not go together.
    """
    from novags.testbed.study.engines.choice import Nodes, OneMachine
    from novags.testbed.study.engines.needs import read_needs

    if name == "ray":
        if workers is not None:
            raise ValueError("workers are processes on this machine; with --engine ray --needs states their needs")
        return Nodes(read_needs(cluster.needs), cluster.address, cluster.retries, url, cluster.scratch)
    if cluster != CLUSTER:
        raise ValueError("address, needs, retries and scratch belong to --engine ray")
    if url is not None:
        raise ValueError(f"store {url}: a URL needs --engine ray")
    return OneMachine.shared(runs, workers, ahead)


def _whole(asked: "Engine", ahead: "Sequence[Worker]") -> "Engine":
    """This machine, one task at a time; refuses options for others or for more."""
    from novags.testbed.study.engines.choice import OneMachine

    if not isinstance(asked, OneMachine):
        raise ValueError("measurements are of this machine: leave out --engine")
    return OneMachine.whole(ahead)


def _forecast(plan: "StudyPlan", folder: Path, engine: "Engine", url: str | None, nodes: tuple[int, ...]) -> str:
    from novags.testbed.study.elsewhere.nodes import known
    from novags.testbed.study.elsewhere.remote import Remote
    from novags.testbed.study.forecast import forecast

    if url is None:
        return forecast(plan, folder, engine, nodes=nodes)
    with TemporaryDirectory(prefix="novags-") as temporary:
        known(plan, Remote(url), Path(temporary))
        return forecast(plan, Path(temporary), engine, url=url, nodes=nodes)


def _conduct(
    plan: "StudyPlan", out: Path, folder: Path, engine: "Engine", url: str | None, retry_failed: bool, overwrite: bool,
    wait: bool,
) -> None:  # fmt: skip
    from novags.testbed.study.conduct import conduct
    from novags.testbed.study.elsewhere.nodes import known
    from novags.testbed.study.elsewhere.remote import Remote
    from novags.testbed.study.results import CSV, counted
    from novags.testbed.study.session import describe, refuse_other

    with writing(out, wait) as console:
        if not overwrite:
            refuse_other(plan, out)
        describe(plan, out, folder, url)
        finished = known(plan, Remote(url), folder) if url else None
        rows = conduct(plan, out, folder, console, engine, retry_failed=retry_failed, known=finished, url=url)
    states = counted(rows)
    say(f"{len(rows)} runs: {', '.join(f'{count} {state}' for state, count in states.items())}")
    say(out / CSV)
    if states.keys() - {"done"}:
        next_(f"look at the reasons in {out / CSV}, then: the same command with --retry-failed")
        raise SystemExit(1)
