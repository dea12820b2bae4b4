"""The type of what is compared."""

import numpy as np

Image: TypeAlias = np.ndarray
