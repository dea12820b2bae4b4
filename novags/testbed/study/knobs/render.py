"""The knobs of the renderer; `simscenes.job.curves` has them and measures them."""

from functools import cache
from pathlib import Path

from novags.testbed.study.knobs.knob import Knob, Reading, Setting, Subject
from simscenes.scenes import SCENES

SCENE = "tabletop"
WHY = {
    "spp": "a set is rendered once and used for everything after it; --spp and --target-error say otherwise",
    "sampler": "its sequences go on for as long as a pixel needs, and two of them give the variance",
    "samples": "even without a target error, uneven towards one: there a pilot has seen where the noise is",
    "denoise": "for previews alone: it is biased, so that held-out views, the truth, never pass it",
    "lights": "lamps are drawn as often as they light what the cameras see",
    "max_depth": "the setting of this curve only: the plan of each scene finds the depth that its light calls for",
    "rr_depth": "roulette from here on: earlier costs noise, later costs time",
    "integrator": "path where the scene holds no medium, volpath where it does: the plan decides",
    "color": "RGB where no material needs spectra: the plan decides from the scene",
    "variant": "the fastest that works on this machine",
}


def render(size: int) -> Subject:
    """Views of a scene of the catalogue, size x size pixels."""
    from simscenes.job import curves

    @cache
    def bench() -> curves.SceneBench:  # when the first measurement is due: it renders references
        return curves.SceneBench(SCENE, size)

    def knob(name: str) -> Knob:
        settings, default = curves.settings_of(name)

        def measured(setting: Setting, seed: int, captured: Path | None) -> Reading:
            found = bench().measure(name, setting, seed)
            return Reading(found.seconds, found.cpu_seconds, found.error)

        alone = name in ("max_depth", "color")  # whose error is another one
        return Knob(
            name=name, settings=settings, default=default, unit=curves.unit_of(name), of="a view",
            why=WHY[name], measure=measured, shared=None if alone else "a view",
        )  # fmt: skip

    workload = {"scene": SCENE, "views": curves.N_VIEWS, "size": f"{size} x {size}", "spp": curves.DEFAULT.spp}
    return Subject(
        "render", workload, tuple(knob(name) for name in curves.KNOBS), (__name__, str(SCENES.module_of(SCENE)))
    )
