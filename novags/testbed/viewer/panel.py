"""The controls at the side of the viewer."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

LEVELS = (-1.0, 4.0)  # log10 of electrons per pixel
MARKS = tuple((float(k), f"{10.0**k:g}") for k in range(-1, 5))
TRUTH, MODEL = "the scene, nearest view", "the reconstruction, this view"
NOTHING = "none"
UNDECIDED = "…"  # until the first capture is open


class ControlPanel:
    """The controls of one browser; `asked` is told which parts of the view they change."""

    def __init__(self, gui: Any, titles: list[str], electrons: float, asked: Callable[..., None]) -> None:
        """Build them. `gui`: of viser; `electrons`: the light to start with."""
        low, high = LEVELS
        start = min(high, max(low, math.log10(electrons)))
        self.capture = gui.add_dropdown("Capture", titles, visible=len(titles) > 1)
        self.method = gui.add_dropdown("Method", [UNDECIDED])
        self.other = gui.add_dropdown("Against", [UNDECIDED], hint="the method that A | B changes to")
        self.switch = gui.add_button("A | B", hint="show the other of the two methods")
        self.pictures = gui.add_dropdown("Pictures", [UNDECIDED], hint="what the frusta of the cameras show")
        self.splats = gui.add_checkbox("Gaussians", True)
        self.cameras = gui.add_checkbox("Cameras", True)
        with gui.add_folder("Expose this view again"):
            self.light = gui.add_dropdown("Light of", [TRUTH, MODEL])
            self.level = gui.add_slider(
                "log10 e-", low, high, 0.05, round(start, 2), marks=MARKS,
                hint="mean signal of green in electrons per pixel, powers of ten",
            )  # fmt: skip
            self.brighten = gui.add_checkbox("Brighten", True, hint="develop with a digital gain up to middle grey")
            self.said = gui.add_markdown("")
            self.exposed = gui.add_image(np.zeros((2, 2, 3), np.uint8), format="png")
        self.trouble = gui.add_markdown("", visible=False)
        self.capture.on_update(lambda _: asked("capture"))
        self.method.on_update(lambda _: asked("splats", "pictures", "light"))
        self.switch.on_click(lambda _: self.swap())
        self.pictures.on_update(lambda _: asked("pictures"))
        self.splats.on_update(lambda _: asked("splats"))
        self.cameras.on_update(lambda _: asked("pictures", "estimated"))
        for control in (self.light, self.level, self.brighten):
            control.on_update(lambda _: asked("light"))

    @property
    def electrons(self) -> float:
        """The light level, e- per pixel."""
        return float(10.0**self.level.value)

    def swap(self) -> None:
        """Show the other method, from where one is: what differs moves, and nothing else."""
        self.method.value, self.other.value = self.other.value, self.method.value

    def offer(self, control: Any, options: tuple[str, ...], preferred: str) -> None:
        """Change the options; the chosen one stays if it can."""
        chosen = control.value
        if tuple(control.options) != options:
            control.options = options
        wanted = chosen if chosen in options else preferred
        if control.value != wanted:
            control.value = wanted
