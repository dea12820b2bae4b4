"""Views of one capture that were not taken alike: exposure time and white balance by view, and how to make them even.

An automatic exposure chooses a time for each view, an automatic white balance a colour temperature, and two exposures
can be interleaved. All factors are relative to an exposure and a white balance common to all views, and known: files
of photographs state them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import Boltzmann, Planck, speed_of_light

from sensor_model.frame.streams import TEMPERATURE, TIME, Draws
from sensor_model.isp import linear_to_srgb, srgb_to_linear, white_balance
from sensor_model.params import Sensor

FULL = 0.98  # of white: a brighter value may be cut off, and says no more than that there is as much light
PRIMARIES = np.array([611.4e-9, 549.1e-9, 464.3e-9])  # m, dominant wavelengths of the primaries of sRGB

Balance = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Uneven:
    """How each view differs from a common exposure; empty where none does.

    Attributes:
        exposures: Exposure time of each view over the common one.
        balances: Red, green and blue of each view's pictures over those of the common white balance.
        matrix: The colour matrix [3, 3] that pictures went through after white balance; None: the identity.
    """

    exposures: tuple[float, ...] = ()
    balances: tuple[Balance, ...] = ()
    matrix: tuple[tuple[float, ...], ...] | None = None

    def times(self, view: int) -> float:
        """The exposure of a view over the common one."""
        return self.exposures[view] if self.exposures else 1.0

    def seen_by(self, sensor: Sensor, view: int) -> Sensor:
        """The camera as the white balance of a view's pictures takes it."""
        return _balanced(sensor, self.balances[view]) if self.balances else sensor

    def even(self, linear: ArrayLike, view: int) -> NDArray[np.float32]:
        """A linear picture [h, w, 3] of a view as the common exposure and white balance would show it.

        Values that may be cut off at white, which is 1, stay as they are: divided, white light would turn grey, or
        coloured.
        """
        if not self.exposures:
            return np.asarray(linear, np.float32)
        factor = self.exposures[view] * np.asarray(self.balances[view])
        into = np.eye(3) if self.matrix is None else np.asarray(self.matrix)
        camera = np.asarray(linear, np.float64) @ np.linalg.inv(into).T
        return np.asarray(np.where(camera < FULL, camera / factor, camera) @ into.T, np.float32)

    def even_srgb(self, code: NDArray, view: int) -> NDArray[np.float32]:
        """`even` for a picture in sRGB code, 0..1."""
        if not self.exposures:
            return code
        linear = self.even(srgb_to_linear(code), view)
        return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), np.float32)

    def even_raw(self, dn: NDArray, view: int, black: float, white: float) -> NDArray:
        """Raw codes of a view as its common exposure would give them, DN; cut-off ones as of `even`."""
        if not self.exposures:
            return dn
        signal = dn.astype(np.float64) - black
        cut = signal >= FULL * (white - black)
        return np.asarray(black + np.where(cut, signal, signal / self.exposures[view]), np.float32)


EVEN = Uneven()


def draw_uneven(
    sensor: Sensor, views: int, *, seed: int, exposure_spread: float, white_balance_spread: float, bracket: float
) -> Uneven:
    """The factors of every view, each by its number and the seed alone.

    Args:
        sensor: The camera.
        views: How many.
        seed: Of the capture.
        exposure_spread: Largest deviation of an exposure time, stops; all up to it are equally likely.
        white_balance_spread: Largest error of the colour temperature, mired; likewise.
        bracket: How many stops longer than the others every second view is exposed, from the second on.
    """
    exposures, balances = [], []
    for view in range(views):
        time, temperature = (2 * _uniform(seed, view, stream) - 1 for stream in (TIME, TEMPERATURE))
        exposures.append(2.0 ** (exposure_spread * time + bracket * (view % 2)))
        balances.append(_balance(sensor, white_balance_spread * temperature))
    return Uneven(exposures=tuple(exposures), balances=tuple(balances))


def _balanced(sensor: Sensor, balance: ArrayLike) -> Sensor:
    """The camera as white balance takes it where a picture's balance is so many times the right one."""
    red, green, blue = np.asarray(sensor.rgb_response) / balance
    return replace(sensor, rgb_response=(float(red / green), 1.0, float(blue / green)))


def _balance(sensor: Sensor, mired: float) -> Balance:
    """Factors on a picture whose white balance is wrong by so much, by Wien's law at the primaries' wavelengths."""
    if not mired:
        return 1.0, 1.0, 1.0
    cast = np.exp(Planck * speed_of_light / Boltzmann * mired * 1e-6 * (1 / PRIMARIES - 1 / PRIMARIES[1]))
    red, green, blue = white_balance(_balanced(sensor, cast)) / white_balance(sensor)
    return float(red), float(green), float(blue)


def _uniform(seed: int, view: int, stream: int) -> float:
    return float(Draws(seed=seed, view=view).uniforms((1, 1), stream)[0, 0])
