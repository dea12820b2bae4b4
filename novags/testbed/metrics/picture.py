"""The type of what is compared."""

from typing import TypeAlias

import numpy as np

Image: TypeAlias = np.ndarray
