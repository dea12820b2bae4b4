"""What accuracy costs in time here: the rows of `Method.knobs`."""

from novags.methods.knob import MethodKnob

FITS = ("likelihood", "structure", "merged")

KNOBS = {
    "Gaussians": MethodKnob.of(
        "gaussians", (1300, 2600, None, 10400), parts=FITS,
        why="of each seed; none is the rule, one for every 11 pixels of all training views and no fewer than there are "
        "points",
    ),
    "seeds": MethodKnob.of(
        "seeds", (1, 2, 3, 4), parts=FITS, why="reconstructions that are merged; each takes the time of the first",
    ),
    "stages": MethodKnob.of(
        "stages", ("likelihood", "all"), parts=("structure",),
        why="all: guided averages and their refit; likelihood fits the raw data and merges its seeds",
    ),
}  # fmt: skip
