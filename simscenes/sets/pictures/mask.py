"""Whether a picture is a mask: one thing white and the rest black, or each thing in one flat colour."""

import numpy as np
from numpy.typing import NDArray

SIDE = 400  # px, longest side of what is looked at
SPAN = 64  # codes between dark and bright; less can be a dark photograph
TAILS = 0.5, 99.5  # percent: hot pixels are no second colour
LABELS = 16  # colours, of a map of things
GREY = 12  # codes between the channels: JPEG, too, keeps grey so
END, BETWEEN = 0.1, 0.05  # of the span: black or white; the largest share of pixels between them, on soft edges


def is_mask(picture: NDArray[np.uint8]) -> bool:
    """Of a picture [h,w,3]."""
    step = -(-max(picture.shape[:2]) // SIDE)
    pixels = picture[::step, ::step].reshape(-1, 3).astype(np.int16)
    low, high = np.percentile(pixels, TAILS)
    if high - low < SPAN:
        return False
    if len(np.unique(pixels, axis=0)) <= LABELS:
        return True
    grey = np.ptp(pixels, axis=1) <= GREY
    place = (pixels.mean(1) - low) / (high - low)
    smaller = min((place < END).mean(), (place > 1 - END).mean())
    between = ((place >= END) & (place <= 1 - END)).mean()
    return bool(grey.mean() > 1 - BETWEEN and between < min(BETWEEN, smaller / 2))
