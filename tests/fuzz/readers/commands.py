"""The command line: arguments damaged, the work itself left out."""

from __future__ import annotations

import functools
import json
import os
import sys
from pathlib import Path
from typing import Any

from tests.fuzz.case import Reader

LINES = [
    "run --preset small --scene tabletop:3 --sensor a7s2-iso6400-3chip --electrons 5.5 --out out --methods nova naive "
    "--variant a=nova-fast:sh_weight=none,fit.iterations=30 --variant v.toml --cameras known:rotation_deg=1 --views 9 "
    "--width 32 --height 24 --spp 16 --points 100 --iterations 10 --denoiser-steps 5 --seed 3 --device cpu "
    "--refine-cameras",
    "plan cornell --sensor camera.toml --electrons 20 --time 0.01 --width 64 --height 48 --tolerance 0.1 "
    "--on 'indirect light' --off 'participating media' --max-depth 5",
    "render scene.xml --out set --views 8 --width 32 --height 32 --target-error 0.05 --export blender llff --seed 1 "
    "--aperture-radius 0.1 --focus-distance 2 --motion 0.3 --allow-outside",
    "render cornell --out set --spp 64 --variant llvm_ad_rgb --response 'Nikon 5100 (NPL)'",
    "capture set --out cap --sensor ideal --electrons 20 --time 0.1 --max-size 800 --demosaic malvar --jpeg-quality 90 "
    "--tolerance None --seed 2",
    "reconstruct cap --out run --method nova --preset demo --pictures 16bit --cameras sfm:pictures=enhanced "
    "--points 50 --iterations 9 --seed 4 --device auto",
    "reconstruct cap --out run --variant b=naive:init_scale=0.5 --cameras vggt:checkpoint=w.pt,drop_percent=20",
    "run --photos walk.mp4 --fps 3 --max-size 96 --overwrite --methods naive oracle --out out",
    "poses walk.mp4 --out poses --fps 1.5 --max-size 800 --max-features 2000 --peak-threshold 0.004 --seed 2 --wait",
    "score run",
    "report run cap --out r.html --overwrite",
    "report run",
    "characterise frames --out c.toml --window 64",
    "import dark --out cap --lit lit --clean clean --sensor ideal --time 0.1 --black 64 --white 1023 --curve linear",
    "doctor",
    "list scenes",
    "help electrons",
]


def make(folder: Path) -> None:
    import shlex

    from sensor_model import PRESETS, write_sensor

    for i, line in enumerate(LINES):
        (folder / f"{i:02d}.argv").write_text(json.dumps(shlex.split(line)))
    write_sensor(folder / "camera.toml", PRESETS["ideal"])
    (folder / "v.toml").write_text('[variant.w]\nmethod = "naive"\n')
    (folder / "scene.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    (folder / "walk.mp4").touch()
    for name in ("set", "cap", "run", "frames"):
        (folder / name).mkdir()


def read(folder: Path, file: Path) -> None:
    """Run a command of which every stage is left out."""
    from novags import cli

    _leave_out_the_work()
    try:
        words = json.loads(file.read_text())
        if not (isinstance(words, list) and all(isinstance(word, str) for word in words)):
            return
        os.chdir(folder)
        for word in words:
            os.fsencode(word)  # other text cannot be an argument
            if "\0" in word:
                return
    except ValueError:
        return
    os.environ["NOVAGS_TRACEBACK"] = "1"
    sys.argv = ["novags", *words]
    try:
        cli.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if code not in (0, 2):
            raise RuntimeError(f"exit status {end.code!r}") from end


def _nothing(*_: Any, **__: Any) -> Any:
    return {}


def _imports() -> None:
    import torch

    import novags.testbed.report.page
    import novags.testbed.study.place  # noqa: F401

    torch.set_num_threads(1)


@functools.cache
def _leave_out_the_work() -> None:
    """In the child, since other readers need the stages."""
    import novags.commands.answers.doctor as doctor
    import novags.testbed.importing.calibration.camera as camera
    import novags.testbed.report.page as page
    import novags.testbed.report.place as place
    import novags.testbed.stages.planning as forecast
    import novags.testbed.study.place as experiment
    from novags.commands import shared
    from novags.testbed import stages

    for module, names in (
        (stages, ("render", "poses", "import_photographs", "capture", "reconstruct", "score")),
        (experiment, ("score_all",)), (doctor, ("examine",)),
    ):  # fmt: skip
        for name in names:
            setattr(module, name, _nothing)
    view = {"error": 0.1, "relative_error": 0.1, "error_by_brightness": [0.1], "noise_by_brightness": [0.1]}
    stages.render = lambda *a, **k: {"views": {"0000": view}}  # type: ignore[assignment]
    experiment.run = lambda *a, **k: Path("report.html")
    page.write_reports = lambda *a, **k: Path("report.html")
    experiment.together = lambda folders: {folder: [] for folder in folders}
    place.places_in = lambda *a: []
    forecast.light_plan = lambda *a, **k: None
    forecast.sensor_plan = lambda *a, **k: ("", {})
    camera.characterise_folder = _refused
    shared.console = lambda: __import__("novags.testbed.console.terminal", fromlist=["Console"]).Console(quiet=True)


def _refused(*_: Any, **__: Any) -> Any:
    from novags.testbed.importing.calibration.camera import MeasuredSetting, OwnCamera

    sensor = __import__("sensor_model").PRESETS["ideal"]
    one = MeasuredSetting(sensor=sensor, found=None, assumed={}, test=(), maps=None, profile=None)
    return OwnCamera(settings={0: one}, fits=())


READERS = [Reader("command line", make, read, ("*.argv",), share=0.5, prepare=_imports, placed=False, odd=False)]
