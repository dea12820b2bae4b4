"""Claims about pictures that are masks: soft edges leave them masks, soft pictures are none."""

import numpy as np
import pytest

from simscenes.sets.pictures.mask import LABELS, is_mask


def edge(width: float, white: float = 255.0) -> np.ndarray:
    """Black to the left and white to the right of a slanted edge of this width."""
    y, x = np.mgrid[0:64, 0:200]
    grey = white * np.clip((x - 100 - y / 9) / width + 0.5, 0, 1)
    return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, 2)


@pytest.mark.parametrize(("width", "white", "mask"), [(1, 255, True), (8, 255, True), (60, 255, False), (8, 50, False)])
def test_black_and_white_with_a_narrow_edge_between_them_is_a_mask(width: float, white: float, mask: bool) -> None:
    picture = edge(width, white)
    assert width == 1 or len(np.unique(picture)) > LABELS
    assert is_mask(picture) == mask
    assert is_mask(255 - picture) == mask
