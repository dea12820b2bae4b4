"""`novags compare`: is a change better?"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from novags.commands.shared import say, variants_of, writing
from novags.options import Device, Name, PresetName, Repeated

BELOW = 3  # exit code: changed is seen to be below


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
        methods: Of two checkouts: the methods to run; nova-fast if not given.
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
    from novags.testbed.study.versions.verdict import Verdict
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
    named = dict.fromkeys([side.method for side in sides if side.method] or methods or ("nova-fast",))
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
        verdicts = {method: Verdict(names, [pair for pair in found if pair.method == method])
                    for method in dict.fromkeys(pair.method for pair in found)}  # fmt: skip
        write_json(record, {**names, "asked": asked, "methods": {m: v.record() for m, v in verdicts.items()}})
        write_text(table, as_csv([{"of": m, **row} for m, verdict in verdicts.items() for row in verdict.rows]))
        for method, verdict in verdicts.items():
            say("\n".join([*([f"{method}:"] if sides[0].method is None else []), *verdict.lines()]))
        if any(verdict.below for verdict in verdicts.values()):
            raise SystemExit(BELOW)


def _variant(name: str, texts: Sequence[str]) -> list[str]:
    """The words that tell `novags reconstruct` of the variant of this name, if it is one of these."""
    mine = [text for text in texts if name in {each.name for each in variants_of((text,))}]
    return [
        word for text in mine for word in ("--variant", str(Path(text).absolute()) if text.endswith(".toml") else text)
    ]
