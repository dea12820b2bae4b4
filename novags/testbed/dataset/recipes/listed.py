"""Every recipe by the name that `recipes = [...]` of a data set calls it."""

from collections.abc import Iterable, Sequence

from novags.testbed.dataset.recipes.dark3r import DARK3R
from novags.testbed.dataset.recipes.denoiser import DENOISER
from novags.testbed.dataset.recipes.feedforward import FEEDFORWARD
from novags.testbed.dataset.recipes.recipe import Recipe, groups_of
from novags.testbed.study.cells.presets import Preset

RECIPES: dict[str, Recipe] = {"denoiser": DENOISER, "dark3r": DARK3R, "feedforward": FEEDFORWARD}


def check_recipes(names: Sequence[str], presets: Iterable[Preset]) -> None:
    """Refuse recipes that do not exist, and captures that they cannot be made of.

    Args:
        names: Of recipes.
        presets: Of all captures.

    Raises:
        ValueError: If there is one of these; names the recipe and the scene.
    """
    groups = groups_of(presets)
    for name in names:
        if name not in RECIPES:
            raise ValueError(f"[dataset] recipes: there is no {name!r}; there are {', '.join(RECIPES)}")
        for group in groups:
            first = group[0]
            try:
                if first.capture.uneven:
                    raise ValueError("views must be exposed alike: leave out exposure_spread, white_balance_spread and "
                                     "bracket")  # fmt: skip
                RECIPES[name].check(group)
            except ValueError as error:
                raise ValueError(f"recipe {name}, scene {first.render.scene}: {error}") from error


def size_of(names: Sequence[str], presets: Iterable[Preset]) -> float:
    """Bytes of the samples of some recipes, a forecast: of all their arrays of pixels."""
    groups = groups_of(presets)
    return sum(RECIPES[name].pixel_bytes(group) * render.n_views * render.width * render.height
               for name in names for group in groups for render in (group[0].render,))  # fmt: skip
