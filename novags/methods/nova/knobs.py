"""What accuracy costs in time here: the rows of `Method.knobs`."""

from novags.methods.knob import MethodKnob


def _width(*channels: int) -> dict[str, object]:
    """Channels of the encoder's levels, then of the bottleneck."""
    return {"denoiser.network.widths": channels[:-1], "denoiser.network.bottleneck": channels[-1]}


KNOBS = {
    "points": MethodKnob(
        option="points", shares=(1 / 8, 1 / 4, 1 / 2, 1.0, 2.0), parts=("fit",),
        why="Gaussians; 0.8 for each pixel of a view, as in the preset",
    ),
    "denoiser steps": MethodKnob(
        option="denoiser_steps", shares=(1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 3.125), parts=("denoiser",),
        why="before the fit, on small crops; the presets demo and small have as many",
    ),
    "denoiser cadence": MethodKnob.of(
        "denoiser.denoise_every", (None, 64, 16), parts=("fit",),
        why="fit iterations between two further steps of the denoiser; none trains it before the fit only",
    ),
    "width": MethodKnob(
        settings={
            "-".join(map(str, channels)): _width(*channels)
            for channels in ((4, 8, 16, 24), (8, 16, 32, 48), (16, 32, 64, 96), (32, 64, 128, 192),
                             (32, 64, 128, 256, 512))
        }, parts=("denoiser",),
        why="channels of the denoiser's levels and bottleneck; half as many as the paper's and a level less, because "
        "its steps are most of the time",
    ),
    "precision": MethodKnob.of(
        "denoiser.network.precision", ("bfloat16", "float32"), parts=("denoiser",),
        why="of the denoiser's convolutions; bfloat16 is for hardware that has it",
    ),
    "mask share": MethodKnob.of(
        "denoiser.blind_spots.mask_fraction", (0.05, 0.2, 0.5), parts=("denoiser",),
        why="share of the pixels that are blinded in a step of the denoiser; no setting costs more",
    ),
    "consistency": MethodKnob.of(
        "consistency.every", (64, 16, 4), parts=("fit",),
        why="fit iterations between two evaluations of the geometric term, each a second rendering",
    ),
}  # fmt: skip
