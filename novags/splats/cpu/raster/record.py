"""The record of one projected Gaussian, a row of sixteen float32: one cache line.

The footprint is kept in sheared form, because the usual conic cancels catastrophically in float32 for needles:

    log2 alpha = TOP - A u^2 - Q dy^2,   u = dx + K dy

with (dx, dy) from the centre (X, Y) to the pixel. With the covariance c and det = c_xx c_yy - c_xy^2: A = c_yy / det,
K = -c_xy / c_yy, Q = 1 / c_yy, the first and last times log2(e) / 2. Both terms are squares, so nothing cancels.
"""

import numpy as np

ROW = 16  # floats
X, Y, A, K, Q, TOP = 0, 1, 2, 3, 4, 5
SLOPE = 6  # dy / dx along which the exponent falls slowest from the centre
REACH_X, REACH_Y = 7, 12  # half size of the box outside which alpha < ALPHA_MIN, pixels
CHANNEL = 8  # first of four
CHANNELS = 4  # composited at once; wider features take several passes

TILE = 16  # pixels
BLOCK = 4  # pixels; 4 x 4 are one vector

ALPHA_MIN = np.float32(1.0 / 255.0)  # a contribution below one 8-bit step is skipped
ALPHA_MAX = np.float32(0.999)  # an opaque Gaussian would divide by 1 - alpha = 0 in the backward pass
TRANSMITTANCE_MIN = np.float32(1e-4)  # a pixel stops before its transmittance would fall below this
LOG2_ALPHA_MIN = np.float32(np.log2(1.0 / 255.0))
HALF_LOG2E = np.float32(0.5 * np.log2(np.e))
