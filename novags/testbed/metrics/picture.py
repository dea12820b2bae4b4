"""The type of compared pictures."""

from typing import TypeAlias

import numpy as np

Image: TypeAlias = np.ndarray
