"""Compile kernels ahead of their first use: `python -m novags.warm [PART ...]`.

Their machine code is kept in this user's cache (`sensor_model.fast.machine_code`); where it is there already, this
takes as long as importing torch.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any

from sensor_model.files.registry import Later, loaded


@dataclass(frozen=True)
class KernelPart:
    """Kernels that are compiled together.

    Attributes:
        title: What they do, for people.
        warm: Runs each of them once.
        folder: "module:NAME" of the folder with their machine code, or of None where no folder can hold it.
        seconds: Compiling takes about so long, on one quiet core of 2023.
    """

    title: str
    warm: Callable[[], None]
    folder: str
    seconds: int


PARTS = {
    "gaussians": KernelPart("fit and render Gaussians", Later("novags.warm:fit_and_average"),
                            "novags.splats.cpu.compiler:CACHE", 85),
    "camera": KernelPart("expose frames", Later("novags.warm:expose_frames"),
                         "sensor_model.fast.kernels:CACHE", 12),
    "fields": KernelPart("train radiance fields", Later("novags.fields.warm:warm"),
                         "novags.splats.cpu.compiler:CACHE", 8),
}  # fmt: skip
BEAT = 15.0  # s between two signs of life
DEMO = ("gaussians", "camera")  # what the demo uses


def compile_ahead(name: str, say: Callable[[str], None]) -> None:
    """Compile a part, once for this user's machine, and say so: a fit would otherwise seem to stand still."""
    part = PARTS[name]
    folder: Path | None = loaded(part.folder)
    done = None if folder is None else folder / f"{name}.compiled"
    if done is not None and done.exists():
        return
    again = "once on this machine" if done else "in every process, see novags doctor"
    say(f"compiling the kernels that {part.title}, about {part.seconds} s, {again}")
    started = time.perf_counter()
    with _signs_of_life(part, say):
        part.warm()
    say(f"compiled the kernels that {part.title}: {time.perf_counter() - started:.0f} s")
    if done is not None and done.parent.is_dir():
        done.touch()


@contextmanager
def _signs_of_life(part: KernelPart, say: Callable[[str], None]) -> Iterator[None]:
    ended, started = Event(), time.perf_counter()

    def beat() -> None:
        while not ended.wait(BEAT):
            say(f"still compiling: {time.perf_counter() - started:.0f} s of about {part.seconds} s")

    thread = Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def kernels_of(config: Any) -> str | None:
    """The part that a method with this configuration trains with, on a CPU; None: none."""
    from novags.fields.training.config import FieldFitConfig
    from novags.splats.training.config import FitConfig

    fit = getattr(config, "fit", None)
    return "gaussians" if isinstance(fit, FitConfig) else "fields" if isinstance(fit, FieldFitConfig) else None


def expose_frames() -> None:
    """Take frames with every kind of light and noise that has a kernel of its own."""
    import numpy as np

    from sensor_model import PRESETS, Exposure, expose

    for name, shape in (("a7s2-iso6400-3chip", (24, 24, 3)), ("a7s2-iso6400", (24, 24)), ("ideal", (24, 24))):
        for shot in ("poisson", "normal", "none"):
            expose(np.full(shape, 30.0), PRESETS[name], Exposure(time=1 / 30), seed=0, view=0, shot=shot)


def fit_and_average() -> None:
    """Call the kernels of the splats, and the kernels that methods have beside them."""
    import numpy as np
    import torch

    from novags.methods.nova.layers.normalise import normalised
    from novags.methods.nova.sh_penalty import penalty_weights
    from novags.methods.nova_plus.average import non_local_means
    from novags.methods.nova_plus.likelihood import FLOOR, compare_tones
    from novags.methods.rivals.le3d.ends import mark
    from novags.methods.tone import ToneCurve
    from novags.splats.warm import warm

    warm()
    picture, tones = torch.full((1, 6, 6, 3), 0.5), np.full((4, 3), 0.5, np.float32)
    next(non_local_means(picture, 0.1))
    normalised(picture.movedim(-1, 1).requires_grad_(), 0.2).sum().backward()
    penalty_weights(torch.ones(4, 2), torch.ones(4, dtype=torch.bool), picture[0, ..., 0])
    compare_tones(tones, tones, 0.1, 2.0, ToneCurve.STEEPEST, np.ones((10, 3)), FLOOR, 0.5, np.empty_like(tones))
    order, reach, seen, ends = np.arange(4), np.ones((4, 2), np.int32), tones[:, :2], np.zeros((2, 4), np.bool_)
    mark(order, seen, reach, tones, tones[:, 0].copy(), 2, 2, 1, *ends)


def main() -> None:
    """Compile the parts that are named, or what the demo uses, and say how long each took."""
    for name in sys.argv[1:] or DEMO:
        if name not in PARTS:
            raise SystemExit(f"no kernels {name!r}; there are: {', '.join(PARTS)}")
        compile_ahead(name, print)


if __name__ == "__main__":
    main()
