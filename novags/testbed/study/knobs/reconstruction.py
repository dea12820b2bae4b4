"""Whole reconstructions as measurements: seconds by part, and the error of held-out views."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods import METHODS
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.knob import MethodKnob
from novags.methods.reconstruction import Reconstruction
from novags.methods.variant import Variant
from novags.settings import changed, flattened, has_setting
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.references import enhanced_truth, pictured
from novags.testbed.ledger.contents import jsonable, read_json
from novags.testbed.metrics.images import aligned_psnr
from novags.testbed.stages.camera_source import CoordinateFrame
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.reconstructing import PreparedProblem, prepare
from novags.testbed.study.cells.presets import Preset, adapted
from novags.testbed.study.knobs.clock import Clock
from novags.testbed.study.knobs.knob import Knob, Reading, Setting
from novags.testbed.study.knobs.options import values
from sensor_model.files.scratch import scratch

SCENE = "tabletop"
QUIET = Console(quiet=True)
_WARM: list[bool] = []  # whether this process has trained before
RENDERED = ("spp", "size")  # options whose settings need a set of their own
# Of every method with knobs; `parts` follow from the method.
ITERATIONS = MethodKnob(
    option="iterations", shares=(1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 3.0),
    why="a third of the preset's, so that many settings can be measured",
)  # fmt: skip
RENDER = {
    "samples per pixel": MethodKnob(
        option="spp", shares=(1 / 16, 1 / 4, 1.0, 4.0), parts=("render",),
        why="of the rendered truth, which is scored against too",
    ),
}  # fmt: skip
RESOLUTION = MethodKnob(
    option="size", shares=(1 / 2, 0.71, 1.0),
    why="width and height of render, pictures and fit; scored at the full size",
)  # fmt: skip


@dataclass(frozen=True)
class PresetBench:
    """A preset with one method."""

    base: Preset

    @property
    def reconstruct(self) -> ReconstructConfig:
        """How its method reconstructs."""
        return self.base.reconstruct(self.base.methods[0])

    def knobs(self) -> tuple[Knob, ...]:
        """The knobs of every reconstruction, around the method's own."""
        work = iterated(self.reconstruct)
        rows = {"iterations": replace(ITERATIONS, parts=work), **self._declared, **RENDER,
                "resolution": replace(RESOLUTION, parts=("render", *work))}  # fmt: skip
        return tuple(self.knob(name, row) for name, row in rows.items())

    @property
    def _declared(self) -> Mapping[str, MethodKnob]:
        return METHODS[self.reconstruct.variant.method].knobs

    def modules(self) -> tuple[str, ...]:
        """The modules that measure, and the modules that the stages of every setting use."""
        turned = [self.preset(row, setting, 0) for row in self._declared.values() for setting in row.settings]
        plain = (self.base.render.code, self.base.capture.code, self.reconstruct.code)
        found = (*plain, *(preset.reconstruct(preset.methods[0]).code for preset in turned))
        return (__name__, *sorted({root for code in found for root in code.roots}))

    def plain(self, seed: int) -> Preset:
        """The experiment of a seed with no knob turned."""
        return adapted(self.base, scene=f"{SCENE}:{seed}", seed=seed)

    def knob(self, name: str, row: MethodKnob) -> Knob:
        """One knob of it."""
        if row.option is None:
            default, settings = row.default(flattened(self.reconstruct.config)), tuple(row.settings)
        else:
            default = value = self._value(row.option, name)
            settings = tuple(dict.fromkeys(max(1, round(value * share)) for share in row.shares))
        work = "a render and a reconstruction" if row.option in RENDERED else "a reconstruction"

        def measured(setting: Setting, seed: int, captured: Path | None) -> Reading:
            assert captured is not None
            return self.measure(row, setting, seed, captured)

        return Knob(
            name=name, settings=settings, default=default, unit="aligned RMSE of held-out views, % of white",
            of=work, why=row.why, measure=measured, shared=work, option=row.option, parts=row.parts,
        )  # fmt: skip

    def _warm(self, prepared: PreparedProblem) -> None:
        """Train briefly, once per process, so that no measurement includes the loading of compiled code."""
        if not _WARM:
            _WARM.append(True)
            timed(prepared, adapted(self.base, iterations=2, denoiser_steps=1).reconstruct(self.base.methods[0]))

    def _value(self, option: str, knob: str) -> int:
        value = values(self.base).get(option)
        if value is None:
            raise ValueError(f"{self.base.methods[0]}: the knob {knob} turns {option}, which this method does not "
                             "have: declare settings of its own instead")  # fmt: skip
        return value

    def preset(self, row: MethodKnob, setting: Setting, seed: int) -> Preset:
        """The experiment of one measurement: a scene and noise of the seed, one knob turned."""
        if row.option is None:
            turned = Variant(name="turned", method=self.base.methods[0], settings=row.settings[setting])
            given: dict[str, Any] = {"variants": (turned,), "methods": (turned.name,)}
        else:
            given = dict(turned_option(row.option, setting))
        return adapted(self.base, scene=f"{SCENE}:{seed}", seed=seed, **given)

    def measure(self, row: MethodKnob, setting: Setting, seed: int, captured: Path) -> Reading:
        """One measurement; new renders for it count into its seconds. `captured`: with no knob turned."""
        preset, parts = self.preset(row, setting, seed), dict[str, float]()
        plain, rendering = open_capture(captured), (0.0, 0.0)
        with ExitStack() as held:
            capture = plain
            if row.option in RENDERED:
                clock, own = Clock(), held.enter_context(scratch("pareto"))
                capture, rendering = photographed(preset, own), clock.read()
                spent = read_json(own / "set" / "set.json")["seconds"]  # samples and pixels change the light alone
                parts["render"] = rendering[1] * spent["radiance"] / sum(spent.values())
            # of a smaller render the error is taken at full size; of a noisier one, against its own light
            truth = plain if row.option == "size" else capture
            config = preset.reconstruct(preset.methods[0])
            prepared = prepare(capture, capture.source(QUIET), config, QUIET)
            self._warm(prepared)
            seconds, trained, result = timed(prepared, config)
            error = held_out_error(result, prepared, capture, truth)
        return Reading(rendering[0] + seconds[0], rendering[1] + seconds[1], error, {**parts, **trained})


def iterated(config: ReconstructConfig) -> tuple[str, ...]:
    """The parts of a training whose steps the iterations of the fit decide."""
    method, name = METHODS[config.variant.method], "fit.iterations"
    if method.parts is None or not has_setting(config.config, name):
        return ()
    own = method.parts(config.config)
    more = method.parts(changed(config.config, {name: 10 * flattened(config.config)[name]}))
    return tuple(part for part, count in own.items() if more[part] != count)


def turned_option(option: str, setting: Any) -> Mapping[str, Any]:
    """One option of a preset, as `adapted` takes it."""
    return {"width": setting, "height": setting} if option == "size" else {option: setting}


def photographed(preset: Preset, folder: Path) -> Capture:
    """The capture of a preset, made in `folder`."""
    stages.render(folder / "set", preset.render, QUIET)
    stages.capture(folder / "set", folder / "capture", preset.capture, QUIET)
    return open_capture(folder / "capture")


def timed(
    prepared: PreparedProblem, config: ReconstructConfig
) -> tuple[tuple[float, float], dict[str, float], Reconstruction]:
    """Train; (wall, processors), processor seconds of each part of the training, and the outcome."""
    method = METHODS[config.variant.method]
    stamps: dict[int, float] = {}
    clock = Clock()

    def progress(done: int, total: int, losses: Mapping[str, float]) -> None:
        stamps[done] = clock.read()[1]

    result = method.train(prepared.problem, config.config, progress=progress)
    return clock.read(), parts_of(stamps, method.parts(config.config) if method.parts else {}), result


def parts_of(stamps: Mapping[int, float], parts: Mapping[str, int]) -> dict[str, float]:
    """Seconds of each part from the times at which its steps, counted through, were done.

    Time before the first step of a part is not counted: each part is extrapolated from its own steps. A part with a
    single stamp is counted from the last stamp of the previous part.
    """
    found, begin = {}, 0
    for name, count in parts.items():
        own = [step for step in range(begin + 1, begin + count + 1) if step in stamps]
        steps = own if len(own) > 1 or begin not in stamps else [begin, *own]
        known = len(steps) > 1
        found[name] = (stamps[steps[-1]] - stamps[steps[0]]) * count / (steps[-1] - steps[0]) if known else 0.0
        begin += count
    return found


def held_out_error(result: Reconstruction, prepared: PreparedProblem, capture: Capture, truth: Capture) -> float:
    """Error of the held-out views at the size of `truth`: 10^(-mean aligned PSNR / 20), % of white.

    A splat is dilated by as much of the picture there as in training.

    Raises:
        ValueError: If no held-out view has contrast, or the method works on pictures that are not enhanced.
    """
    if result.enhancement is None:
        raise ValueError("a method that states no enhancement cannot be measured: its pictures are compared with the "
                         "noise-free exposure through the same enhancement")  # fmt: skip
    scale = truth.cameras.rig.width / capture.cameras.rig.width
    scene = result.scene
    if isinstance(scene, GaussianScene):
        scene = replace(scene, eps2d=scene.eps2d * scale**2)
    frame = CoordinateFrame.of(truth, prepared.indices, prepared.estimate, result.viewmats)
    found = []
    for i in truth.cameras.test_indices:
        rendered = scene.render(frame.view(i, prepared.device))[0][0].cpu().numpy().astype(np.float32)
        image = pictured(result, capture, rendered)
        reference = enhanced_truth(truth, i, jsonable(result.enhancement))
        if (score := aligned_psnr(image, reference)) is not None:
            found.append(score)
    if not found:
        raise ValueError(f"no held-out view of {truth.path} has contrast: there is nothing to score")
    return float(100 * 10 ** (-np.mean(found) / 20))
