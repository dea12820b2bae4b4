"""Whole reconstructions as measurements: seconds by part, and the error of held-out views."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods import METHODS
from novags.methods.reconstruction import GaussianScene, Reconstruction
from novags.methods.variant import Variant
from novags.settings import flattened
from novags.testbed import stages
from novags.testbed.cache import jsonable, read_json
from novags.testbed.console import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.metrics import aligned_psnr
from novags.testbed.pareto.clock import Clock
from novags.testbed.pareto.knob import Knob, Measured, Setting
from novags.testbed.presets import Preset, adapted
from novags.testbed.references import enhanced_truth
from novags.testbed.stages.camera_source import Frame
from novags.testbed.stages.reconstruct import Prepared, ReconstructConfig, prepare
from sensor_model.files.scratch import scratch

SCENE = "tabletop"
QUIET = Console(quiet=True)
_WARM: list[bool] = []  # whether this process has trained before
RENDERED = ("spp", "size")  # options whose settings need a set of their own


@dataclass(frozen=True)
class Row:
    """A knob of a reconstruction.

    Attributes:
        settings: Shares of the preset's own value for an `option`, else values; from the fastest on.
        why: Of the default.
        option: A number of the preset: iterations, points, denoiser_steps, spp, or size (width and height).
        setting: Or one of the method, by dotted name.
        parts: Whose time it changes: render, and the parts of the method's training.
    """

    settings: tuple[Setting, ...]
    why: str
    option: str | None = None
    setting: str | None = None
    parts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bench:
    """A preset with one method, and where the sets and captures of its seeds are kept."""

    base: Preset
    folder: Path

    def knob(self, name: str, row: Row) -> Knob:
        """One knob of it."""
        default, settings = self._default(row), row.settings
        if row.option is not None:
            settings = tuple(dict.fromkeys(max(1, round(default * share)) for share in row.settings))
        renders = row.option in RENDERED

        def measured(setting: Setting, seed: int) -> Measured:
            return self.measure(row, setting, seed)

        return Knob(
            name=name, settings=settings, default=default, unit="aligned RMSE of held-out views, % of white",
            of="a render and a reconstruction" if renders else "a reconstruction", why=row.why, measure=measured,
            shared="a render and a reconstruction" if renders else "a reconstruction", option=row.option,
            parts=row.parts,
        )  # fmt: skip

    def _warm(self, prepared: Prepared) -> None:
        """Train a little, once in a process: loading the machine code is no part of any measurement."""
        if not _WARM:
            _WARM.append(True)
            timed(prepared, adapted(self.base, iterations=2, denoiser_steps=1).reconstruct(self.base.methods[0]))

    def _default(self, row: Row) -> Any:
        config = flattened(self.base.reconstruct(self.base.methods[0]).config)
        places = {
            "iterations": config.get("fit.iterations"), "denoiser_steps": config.get("denoiser.warmup_steps"),
            "points": self.base.points, "spp": self.base.render.spp, "size": self.base.render.width,
        }  # fmt: skip
        return config[row.setting] if row.setting is not None else places[str(row.option)]

    def preset(self, row: Row, setting: Setting, seed: int) -> Preset:
        """The experiment of one measurement: a scene and noise of the seed, one setting changed."""
        if row.setting is not None:
            turned = Variant(name="turned", method=self.base.methods[0], settings={row.setting: setting})
            changed: dict[str, Any] = {"variants": (turned,), "methods": (turned.name,)}
        else:
            changed = dict(turned_option(str(row.option), setting))
        return adapted(self.base, scene=f"{SCENE}:{seed}", seed=seed, **changed)

    def measure(self, row: Row, setting: Setting, seed: int) -> Measured:
        """One measurement; what is rendered anew for it counts into its seconds."""
        preset, parts = self.preset(row, setting, seed), dict[str, float]()
        kept = self.folder / f"seed-{seed}"
        clock = Clock()
        with ExitStack() as held:
            own = kept if row.option not in RENDERED else held.enter_context(scratch("pareto"))
            capture = photographed(preset, own)
            rendering = clock.read() if row.option in RENDERED else (0.0, 0.0)
            if row.option in RENDERED:  # what samples and pixels change is the light alone
                spent = read_json(own / "set" / "set.json")["seconds"]
                parts["render"] = rendering[1] * spent["radiance"] / sum(spent.values())
            # of a smaller render the error is that at full size; of a noisier one, against what it shows itself
            plain = adapted(self.base, scene=f"{SCENE}:{seed}", seed=seed)
            truth = photographed(plain, kept) if row.option == "size" else capture
            config = preset.reconstruct(preset.methods[0])
            prepared = prepare(capture, capture.source(QUIET), config, QUIET)
            self._warm(prepared)
            seconds, trained, result = timed(prepared, config)
            error = held_out_error(result, prepared, capture, truth)
        return Measured(rendering[0] + seconds[0], rendering[1] + seconds[1], error, {**parts, **trained})


def turned_option(option: str, setting: Any) -> Mapping[str, Any]:
    """One option of a preset, as `adapted` takes it."""
    return {"width": setting, "height": setting} if option == "size" else {option: setting}


def photographed(preset: Preset, folder: Path) -> Capture:
    """The capture of a preset, made where it is missing."""
    stages.render(folder / "set", preset.render, QUIET)
    stages.capture(folder / "set", folder / "capture", preset.capture, QUIET)
    return open_capture(folder / "capture")


def timed(
    prepared: Prepared, config: ReconstructConfig
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

    What comes before the first step is no part's: a part that begins the work is extrapolated from its other steps.
    """
    found, begin = {}, 0
    for name, count in parts.items():
        steps = [step for step in range(begin, begin + count + 1) if step in stamps]
        known = len(steps) > 1
        found[name] = (stamps[steps[-1]] - stamps[steps[0]]) * count / (steps[-1] - steps[0]) if known else 0.0
        begin += count
    return found


def held_out_error(result: Reconstruction, prepared: Prepared, capture: Capture, truth: Capture) -> float:
    """Of the held-out views at the size of `truth`: 10^(-mean aligned PSNR / 20), % of white.

    A splat is dilated by as much of the picture there as in training.

    Raises:
        ValueError: If no held-out view has contrast.
    """
    assert result.enhancement is not None  # the preset's method works on enhanced pictures
    scale = truth.cameras.rig.width / capture.cameras.rig.width
    scene = result.scene
    if isinstance(scene, GaussianScene):
        scene = replace(scene, eps2d=scene.eps2d * scale**2)
    frame = Frame.of(truth, prepared.indices, prepared.estimate, result.viewmats)
    found = []
    for i in truth.cameras.test_indices:
        image = scene.render(frame.view(i, prepared.device))[0][0].cpu().numpy().astype(np.float32)
        reference = enhanced_truth(truth, i, jsonable(result.enhancement))
        if (score := aligned_psnr(image, reference)) is not None:
            found.append(score)
    if not found:
        raise ValueError(f"no held-out view of {truth.path} has contrast: there is nothing to score")
    return float(100 * 10 ** (-np.mean(found) / 20))
