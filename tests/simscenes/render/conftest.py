"""A camera before the ball on a plane."""

from collections.abc import Callable

import pytest

from simscenes import Rig
from simscenes.rigs import intrinsics, look_at


@pytest.fixture(scope="session")
def view() -> Callable[..., Rig]:
    """One view of any size, its principal point off the middle."""

    def make(width: int = 41, height: int = 31) -> Rig:
        K = intrinsics(width, height, 50)
        K[0, 2] += 3.3
        return Rig(viewmats=look_at((3, -4, 2.5), (0.2, 0.1, 0.8))[None], Ks=K[None], width=width, height=height)

    return make
