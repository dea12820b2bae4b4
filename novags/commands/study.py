"""`novags study`: a grid of runs. `novags compare`: a small one, of two versions."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

from novags.commands import shared
from novags.commands.shared import next_, say, say_ranking, typed, variants_of, writing
from novags.options import CLUSTER, Cluster, Device, Folder, Name, PresetName, Repeated

if TYPE_CHECKING:
    from novags.testbed.study.engines.choice import Engine
    from novags.testbed.study.engines.processes import Worker
    from novags.testbed.study.plan import StudyPlan

BELOW = 3  # exit code: changed is seen to be below


def study(
    file: Folder, *, out: Path, store: str | None = None, engine: Literal["local", "ray"] = "local",
    workers: int | None = None, cluster: Cluster = CLUSTER, dry_run: bool = False, nodes: tuple[int, ...] = (),
    data: Path | None = None, retry_failed: bool = False, overwrite: bool = False, wait: bool = False,
) -> None:  # fmt: skip
    """Run a grid of scenes, cameras, light levels, methods and seeds from one file.

    Stages that runs share are done once. Finished work is kept: the same command again does only the rest. A run that
    fails becomes a row with its reason, and the rest goes on.

    Args:
        file: The study, a TOML file: `novags help studies` says what it holds, `novags new study NAME` writes one.
        out: Folder of its tables and logs.
        store: Folder of all sets, captures and runs, which studies share; `store` beside `out` if not given. With
            --engine ray a folder that all nodes see, or a URL for fsspec.
        engine: Where the work is done: on this machine, or on a Ray cluster.
        workers: Processes at a time on this machine; all cores are divided among them. As many as there are cores, or
            runs, if not given.
        cluster: Of --engine ray.
        dry_run: Only show the runs, and their cost: time, memory, disk. Nothing is written.
        nodes: With --dry-run: how long it would take on so many machines like this one; several numbers.
        data: Folder below which the published data sets are whose scenes the file names; see `novags import`.
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
    from novags.testbed.study.session import again, describe, refuse_other

    with writing(out, wait) as console:
        if not overwrite:
            refuse_other(plan, out)
            if why := again(plan, out, folder):
                console.note(f"study: made again, {why}")
        describe(plan, out, folder, url)
        finished = known(plan, Remote(url), folder) if url else None
        rows = conduct(plan, out, folder, console, engine, retry_failed=retry_failed, known=finished, url=url)
    states = counted(rows)
    say(f"{len(rows)} runs: {', '.join(f'{count} {state}' for state, count in states.items())}")
    if states.get("done") and "method" in plan.study.axes:
        say_ranking(out)
    say(out / CSV)
    if states.keys() - {"done"}:
        next_(f"look at the reasons in {out / CSV}, then: the same command with --retry-failed")
        raise SystemExit(1)
    next_(f"novags report {typed(out)}")


def compare(
    base: Name, changed: Name, *, methods: tuple[str, ...] = (), variant: Repeated = (),
    captures: tuple[Path, ...] = (), scenes: tuple[str, ...] = (), seeds: tuple[int, ...] = (0, 1),
    preset: PresetName = "demo", points: int | None = None, iterations: int | None = None,
    denoiser_steps: int | None = None, device: Device = "auto", out: Path | None = None, overwrite: bool = False,
    wait: bool = False, dry_run: bool = False,
) -> None:  # fmt: skip
    """Say whether a change is better: two checkouts, or two methods, on the same captures, paired by seed and view.

    Each fit has a process of its own, with the code of its side, and both are scored by the code of this command. Fits
    that are there are kept while their code is what it was. Exit code 3: a main score of CHANGED is seen to be below.

    Args:
        base: A folder with a checkout of novags, a revision of this one (HEAD~1), or a method or variant.
        changed: Likewise.
        methods: Of two checkouts: the methods to run; the first of the preset if not given.
        variant: As of `novags run`: a method with settings changed, NAME=METHOD:SETTING=VALUE; or a TOML file of them.
        captures: Folders of captures, of runs or of experiments; if not given, small captures are made.
        scenes: Of these captures, one for each seed; tabletop:3, cornell, busts and bookshop if not.
        seeds: Of the fits, and of the noise of captures that are made.
        preset: Source of every setting that is not given here.
        points: Gaussians at the start; 4000 on small captures, else the preset's, if not given.
        iterations: Of the fit; 800 on small captures, else the preset's, if not given.
        denoiser_steps: Of the denoiser before the fit starts.
        device: Where training runs; auto takes a GPU if there is one that can be used.
        out: Folder of the comparison; out/compare-BASE-CHANGED if not given.
        overwrite: Replace fits of other captures or settings in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say which captures and fits there would be. Nothing is written.
    """
    from novags.settings import check_seed
    from novags.testbed.console.csv_text import as_csv
    from novags.testbed.ledger.contents import write_json
    from novags.testbed.ledger.dry import planned
    from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
    from novags.testbed.study.versions import pairs
    from novags.testbed.study.versions.sides import sides_of
    from novags.testbed.study.versions.verdict import ComparisonVerdict
    from sensor_model.files.atomic import write_text
    from simscenes.sets.names import safe_name

    for seed in seeds:
        check_seed(seed)
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds must be named once each, one at least, got {' '.join(map(str, seeds)) or 'none'}")
    if captures and scenes:
        raise ValueError("scenes are of captures that are made: leave out --scenes or --captures")
    own = variants_of(variant)
    folder = Path("out") / safe_name(f"compare-{base}-{changed}") if out is None else out
    sides = sides_of(base, changed, own, folder / "code")
    if methods and sides[0].method is not None:
        raise ValueError(f"methods are those of two checkouts, and {base} is a method: leave out --methods")
    small: dict[str, Any] = {} if captures else {"points": pairs.POINTS, "iterations": pairs.ITERATIONS}
    given = {"points": points, "iterations": iterations, "denoiser_steps": denoiser_steps}
    asked = small | {name: value for name, value in given.items() if value is not None}
    named = dict.fromkeys([side.method for side in sides if side.method] or methods or EXPERIMENTS[preset].methods[:1])
    chosen = adapted(EXPERIMENTS[preset], methods=tuple(named), variants=own, **asked)
    shared = [word for name, value in asked.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    shared += ["--preset", preset, "--device", device, *(["--overwrite"] if overwrite else [])]
    words = {name: [*shared, *_variant(name, variant)] for name in chosen.methods}
    with writing(folder, wait, dry_run=dry_run) as console:
        store, record, table = (folder / name for name in ("store", "compare.json", "compare.csv"))
        plan = None if captures else pairs.made(scenes or pairs.SCENES, seeds, preset, store, console)
        cases = [] if plan else pairs.given(captures, seeds, console)
        count = len(plan.runs if plan else cases) * (len(words) if sides[0].method is None else 1)
        console.note(f"compare: {count} pairs of fits, of {len(plan.runs) if plan else len(captures)} captures")
        parts = [*(["captures", "store"] if plan else []), *(["code"] if any(side.commit for side in sides) else [])]
        parts += [*(side.role for side in sides), "logs", record.name, table.name]
        planned(console, "compare", [folder / name for name in parts])
        for side in sides:
            side.lay_out()
        found = pairs.fit_pairs(
            sides, pairs.make(plan, folder / "captures", store, console) if plan else cases, words, folder, console
        )
        names = {side.role: side.said for side in sides}
        verdicts = {method: ComparisonVerdict(names, [pair for pair in found if pair.method == method])
                    for method in dict.fromkeys(pair.method for pair in found)}  # fmt: skip
        write_json(record, {**names, "asked": asked, "methods": {m: v.record() for m, v in verdicts.items()}})
        write_text(table, as_csv([{"of": m, **row} for m, verdict in verdicts.items() for row in verdict.rows]))
        for method, verdict in verdicts.items():
            say("\n".join([*([f"{method}:"] if sides[0].method is None else []), *verdict.lines()]))
        if any(verdict.below for verdict in verdicts.values()):
            raise SystemExit(BELOW)


def compare_sets(
    twin: Folder, real: Folder, *, against: str | None = None, where: tuple[str, ...] = (), noise: bool = True,
    out: Path | None = None,
) -> None:  # fmt: skip
    """Say whether a simulated study predicts a real one: the order of methods, their differences, the noise.

    Scenes need not be the same: nothing is paired across the two. Noise is estimated from the pictures of both.

    Args:
        twin: Folder of the simulated study.
        real: Folder of the study of photographs, with the same methods.
        against: The method that others are compared with; the floor of the scale if not given.
        where: NAME=VALUE: of an axis with several values the one that counts, of the side that has it.
        noise: Compare the noise of the pictures too.
        out: A new CSV file for the differences; none if not given.
    """
    from novags.testbed.console.csv_text import as_csv
    from novags.testbed.study.versions.twins import TwinVerdict, both_sides, floor_of, noise_ratios
    from sensor_model.files.atomic import write_text

    if out is not None and out.exists():
        raise ValueError(f"{out} is there already: name another file, or remove it")
    chosen = dict(word.partition("=")[::2] for word in where)
    if wrong := next((word for word in where if "=" not in word), None):
        raise ValueError(f"--where must be NAME=VALUE, got {wrong!r}")
    sides = both_sides(twin, real, chosen)
    ratios = noise_ratios(*(side.pictures() for side in sides)) if noise else []
    verdict = TwinVerdict(*sides, against or floor_of(sides[0].methods), ratios)
    lines = verdict.lines()
    if out is not None:
        write_text(out, as_csv(verdict.rows()))
    say("\n".join(lines))


def _variant(name: str, texts: Sequence[str]) -> list[str]:
    """The words that tell `novags reconstruct` of the variant of this name, if it is one of these."""
    mine = [text for text in texts if name in {each.name for each in variants_of((text,))}]
    return [
        word for text in mine for word in ("--variant", str(Path(text).absolute()) if text.endswith(".toml") else text)
    ]
