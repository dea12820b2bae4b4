"""Copy plain channels (colours, features, depth) into the records of the Gaussians."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import kernel
from .record import CHANNEL, CHANNELS

ZERO = np.float32(0.0)


@kernel
def fill(begin, end, features, depths, first_channel, depth_channel, radii, rows, suspect):
    """Write channels first_channel.. of features [N, D], and depth as channel depth_channel, to rows [N, ROW].

    Channels beyond both become zero. Sets suspect[0] if a feature is not finite.
    """
    n_features = features.shape[1]
    for i in range(begin, end):
        for j in range(CHANNELS):
            channel = first_channel + j
            value = ZERO
            if channel < n_features:
                value = features[i, channel]
                if not abs(value) < np.inf:
                    suspect[0] = 1
            elif channel == depth_channel:
                value = depths[i]
            if radii[i] > 0:
                rows[i, CHANNEL + j] = value
