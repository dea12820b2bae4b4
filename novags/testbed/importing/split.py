"""Which views are held out for testing."""

from dataclasses import replace
from typing import Literal

from simscenes.sets.multiview import MultiviewSet

# "own": as the folder or the data set says, every 8th where it says nothing; "every8": every 8th in any case, in the
# order of the names, from 0, as the NOVA-GS paper does for all data sets.
Split = Literal["own", "every8"]


def divided(views: MultiviewSet, split: Split) -> MultiviewSet:
    """The same views with the held-out ones of this split."""
    return views if split == "own" else replace(views, held_out=None)
