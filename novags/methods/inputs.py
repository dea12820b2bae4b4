"""Which pictures a method is given, and its message where they are not enough."""

from typing import Literal

Pictures = Literal["8bit", "16bit"]


class LacksInput(ValueError):
    """A method needs data that a capture does not have; another method may do without."""
