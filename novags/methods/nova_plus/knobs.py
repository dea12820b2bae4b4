"""What accuracy costs in time here: the rows of `Method.knobs`."""

from novags.methods.knob import MethodKnob

FITS = ("likelihood", "structure", "merged")

KNOBS = {
    "points": MethodKnob(
        option="points", shares=(1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0), parts=FITS,
        why="at the start, 0.8 for each pixel of a view, as in the preset; a short fit has no time to grow many more",
    ),
    "Gaussians": MethodKnob.of(
        "gaussians", (1300, 2600, None), parts=FITS,
        why="of each seed; none is the rule: one for every 11 pixels of all training views, however many points "
        "there are",
    ),
    "seeds": MethodKnob.of(
        "seeds", (1, 2, 3, 4), parts=FITS,
        why="reconstructions that are merged, each of which takes the time of the first; the second gains little, and "
        "further ones nothing that could be measured",
    ),
    "stages": MethodKnob.of(
        "stages", ("likelihood", "all"), parts=("denoiser", "structure"),
        why="all has averages, denoised data and their refit; likelihood fits the raw data and merges its seeds",
    ),
}  # fmt: skip
