"""Claims about what is said of a budget."""

from novags.testbed.study.budget.choice import Option
from novags.testbed.study.budget.said import untried
from novags.testbed.study.cells.presets import EXPERIMENTS
from novags.testbed.study.knobs.options import values


def test_the_least_setting_of_every_option_is_said_whatever_their_order() -> None:
    preset = EXPERIMENTS["demo"]
    own = values(preset)
    for shares in ((1.0, 0.5, 0.25), (0.25, 0.5, 1.0)):
        options = {name: [Option(name, share, {}, 0.0, 0.0) for share in shares] for name in ("iterations", "spp")}
        said = " ".join(untried(preset, 100.0, 10.0, options, "of somebody"))
        for name in options:
            assert f"{own[name]} -> {round(own[name] / 4)} at the least" in said
