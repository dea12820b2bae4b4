"""Photon transfer: the parameters of a real (or simulated) camera from dark and flat frames, after EMVA 1288.

A stack is several frames of the same uniform light; `mean` and `variance` below are its spatial average of the temporal
mean and of the temporal variance, in DN and DN**2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sensor_model.params import Defects, Sensor, require

Array = NDArray[np.float64]
QUANTISATION = 1 / 12  # DN**2
UNDERFLOW = 0.005  # of the dark pixels that may be 0: more, and clipping hides the camera's noise
HOT = 6  # standard deviations (robust ones over all pixels, and of the pixel's own noise) beyond which a pixel is hot
COLD = 1e-6  # least dark current of normal pixels, as a share of the hot ones', which is stated as a multiple of it
STEP = 0.4  # relative error of the variance of read noise, from which one gain does not explain it at all ISOs
CROOKED = 0.2  # linearity error beyond which the stated light must be wrong, and not the camera
UNITS = {"gain": "DN/e-", "black_level": "DN", "dark_current": "e-/s"} | dict.fromkeys(
    ("sigma_d", "sigma_row", "sigma_column", "dsnu", "mu_e_sat"), "e-"
)


@dataclass(frozen=True)
class Stack:
    """Frames of one light and one exposure time."""

    frames: NDArray  # [n, h, w], n >= 2, DN; of a colour filter array pass one plane, frames[:, r::2, c::2]
    time: float  # s
    photons: float | None = None  # mean photons per pixel; None: unknown (0 for a dark stack is understood)

    def __post_init__(self) -> None:
        """Check every field."""
        shape = np.shape(self.frames)
        require(len(shape) == 3 and shape[0] >= 2 and min(shape[1:]) >= 8, "frames", "[n >= 2, h >= 8, w >= 8]", shape)
        require(self.time >= 0, "time", ">= 0 s", self.time)
        require(self.photons is None or self.photons >= 0, "photons", "None or >= 0", self.photons)


@dataclass(frozen=True, kw_only=True)
class Characterisation:
    """The parameters of a camera from its frames; symbols as in `Sensor`."""

    gain: float  # DN/e-
    eta: float | None  # None without photon numbers
    sigma_d: float  # e-, row and column noise taken out
    sigma_row: float  # e-
    sigma_column: float  # e-
    black_level: float  # DN
    dark_current: float  # e-/s, of pixels that are not hot
    dsnu: float  # e-, of these
    prnu: float
    hot_fraction: float  # of the pixels
    hot_factor: float  # their mean dark current over the other pixels'
    mu_e_sat: float | None  # e-; None if no stack saturates
    nonlinearity: float  # relative loss of response at the largest signal seen (full well), from a parabola
    linearity_error: float  # largest deviation from the straight line between 5 % and 95 % of saturation, relative

    def __str__(self) -> str:
        """A table."""
        known = {name: value for name, value in asdict(self).items() if value is not None}
        return "\n".join(f"{name:>16} {value:.5g} {UNITS.get(name, '')}".rstrip() for name, value in known.items())

    def at_gain(self, gain: float) -> Characterisation:
        """The same frames by a gain that is known better: codes are measured, so that electrons follow it. DN/e-."""
        known = {name: getattr(self, name) for name, unit in UNITS.items() if unit[:2] == "e-"} | {"eta": self.eta}
        scaled = {name: value * self.gain / gain for name, value in known.items() if value is not None}
        return replace(self, gain=gain, **scaled)

    def sensor(self, *, bits: int, **assumed: object) -> Sensor:
        """A camera with these parameters; `assumed` adds parameters that frames cannot show, and overrides measured
        ones.
        """
        names = ("gain", "eta", "sigma_d", "sigma_row", "sigma_column", "black_level", "dark_current", "dsnu", "prnu")
        measured = {name: getattr(self, name) for name in (*names, "mu_e_sat")}
        if self.mu_e_sat is not None:  # the non-linearity is relative to it
            measured["nonlinearity"] = self.nonlinearity
        if self.hot_fraction > 0:
            measured["defects"] = Defects(hot_fraction=self.hot_fraction, hot_factor=self.hot_factor)
        values = {"bits": bits, "cfa": None} | measured | assumed
        if "nonlinearity" in measured and "nonlinearity" not in assumed:  # measured was the bend per electron
            values["nonlinearity"] = self.nonlinearity * values["mu_e_sat"] / self.mu_e_sat
        for name in ("eta", "mu_e_sat"):
            require(values[name] is not None, name, "known", None, f"measure it, or pass {name}=")
        return Sensor(**values)


def characterise(dark: Sequence[Stack], flat: Sequence[Stack]) -> Characterisation:
    """Estimate a camera's parameters.

    Args:
        dark: Stacks without light, at two exposure times or more.
        flat: Stacks of uniform light, at three levels or more, best from 5 % of saturation to beyond it. Their light
            must be proportional to the exposure time, unless all carry their photon numbers.

    Returns:
        The estimates. `dsnu` and `prnu` come from the stacks with the most frames alone: give one dark and one at half
        saturation, of ten frames or more, at the same exposure time.

    Raises:
        ValueError: if there are too few stacks, no flat stack is between dark and saturation, dark frames are cut off
            at 0, or the flat frames do not follow the light that is stated.

    Source: EMVA 1288 release 4, linear: gain from the photon transfer curve up to 70 % of saturation (its section 6),
    dark noise from the variance extrapolated to zero time, DSNU and PRNU from the spatial variance of averaged stacks
    less the temporal variance that remains in them (section 8). A bent response is straightened first. A lamp or a
    shutter may vary from frame to frame, and light may fall off smoothly towards the corners: neither is noise. Hot
    pixels, which EMVA 1288 leaves in its averages, are counted by themselves: one in a thousand can make six electrons
    of DSNU out of one. They need eight frames in the shortest and the longest dark stack: of two to four, up to one
    pixel in 40,000 looks hot where read noise has heavy tails or telegraph pixels.
    """
    _check(dark, flat)
    hot, excess = _hot_pixels(dark)
    dark, flat = [_without(s, hot) for s in dark], [_without(s, hot) for s in flat]
    dark_line, dark_noise = _line(dark, _mean), _line(dark, temporal_variance)
    time = np.array([s.time for s in flat])
    signal = np.array([_mean(s) for s in flat]) - (dark_line[0] + dark_line[1] * time)
    noise = np.array([temporal_variance(s) for s in flat]) - (dark_noise[0] + dark_noise[1] * time)

    peak = float(signal[np.argmax(noise)])  # variance collapses where pixels saturate
    saturated = (signal >= peak) & (noise < 0.5 * noise.max())
    used = (signal > 0) & (signal <= 0.7 * peak)
    require(bool(used.any()), "flat", "with a stack below 70 % of saturation", np.round(signal, 1).tolist())
    photons = np.array([np.nan if s.photons is None else s.photons for s in flat])
    known = not np.isnan(photons).any()
    light = photons if known else time
    bend, error = _linearity(light, signal, peak)
    told = "the stated photons" if known else "the exposure times"
    remedy = "" if known else "; or leave the lamp alone and vary the time, or state the photons of every stack"
    require(error <= CROOKED, f"the relative error of a straight line through flat signals over {told}",
            f"at most {CROOKED}", round(error, 3), f"correct them{remedy}")  # fmt: skip
    straight, slope = _straightened(signal, bend)
    gain = _proportional(straight[used], (noise / slope**2)[used])
    row, column, pixel = noise_parts(dark, dark_noise[0])
    current = max(dark_line[1], COLD * excess)  # below 0, where there is next to none, by chance
    top = _straightened(np.array([max(_mean(s) for s in flat) - dark_line[0]]), bend)[0][0]
    return Characterisation(
        gain=gain,
        eta=_proportional(light[used], straight[used]) / gain if known else None,
        sigma_d=_root(pixel - QUANTISATION) / gain,
        sigma_row=_root(row) / gain,
        sigma_column=_root(column) / gain,
        black_level=dark_line[0],
        dark_current=current / gain,
        dsnu=_root(_spatial_variance(_largest(dark))) / gain,
        prnu=_prnu(dark, [s for s, keep in zip(flat, used, strict=True) if keep], dark_line, bend),
        hot_fraction=float(hot.mean()),
        hot_factor=1 + excess / current if excess > 0 else 1.0,
        mu_e_sat=float(top) / gain if saturated.any() else None,
        nonlinearity=max(bend * float(top), 0.0),
        linearity_error=error,
    )


def _check(dark: Sequence[Stack], flat: Sequence[Stack]) -> None:
    """Refuse frames that no camera can be estimated from."""
    times = sorted({s.time for s in dark})
    require(len(times) >= 2, "dark", "stacks at two exposure times or more", times,
            "dark current is their difference: add frames of another time")  # fmt: skip
    require(len(flat) >= 3, "flat", "three stacks or more", len(flat))
    shapes = {np.shape(s.frames)[1:] for s in (*dark, *flat)}
    require(len(shapes) == 1, "frames", "of one shape in all stacks", sorted(shapes))
    cut = max(float(np.mean(np.asarray(s.frames) <= 0)) for s in dark)
    remedy = "noise is cut off there: raise the black level (offset) of the camera"
    require(cut <= UNDERFLOW, "the share of dark pixels at 0 DN", f"at most {UNDERFLOW}", round(cut, 4), remedy)


def _proportional(x: Array, y: Array) -> float:
    """Slope of the best straight line through the origin."""
    return float(x @ y / (x @ x))


def _straightened(signal: Array, bend: float) -> tuple[Array, Array]:
    """The signal of a linear camera instead of x - bend x**2, and the slope of the bend there. DN.

    Shot noise is proportional to that signal and shrinks by that slope; a photon transfer curve of the bent signal
    alone would read the gain of a camera with 2 % of non-linearity 3 % too low.
    """
    slope = np.sqrt(np.maximum(1 - 4 * bend * signal, 0.01))  # no signal lies beyond the top of the parabola
    return 2 * signal / (1 + slope), slope


def _mean(stack: Stack) -> float:
    return float(np.mean(stack.frames, dtype=np.float64))


def average(stack: Stack) -> Array:
    """Of each pixel over the frames, [h, w]."""
    return np.asarray(np.mean(stack.frames, axis=0, dtype=np.float64))


def _squares(stack: Stack) -> Iterator[Array]:
    """Of each frame the squared temporal deviation of every pixel, [h, w], without the changes that all pixels of a
    frame share, such as the flicker of a lamp (EMVA 1288, section 6).
    """
    mean = average(stack)
    pattern = mean - mean.mean()
    for frame in stack.frames:
        yield np.square(frame - frame.mean(dtype=np.float64) - pattern)


def temporal_variance(stack: Stack) -> float:
    """Mean over the pixels of their temporal variance."""
    n, h, w = np.shape(stack.frames)
    return float(np.sum([square.sum() for square in _squares(stack)])) / ((n - 1) * (h * w - 1))


def _variance_of_average(stack: Stack) -> Array:
    """Temporal variance that is left in the average of each pixel, [h, w]."""
    n = len(stack.frames)
    return np.asarray(sum(_squares(stack))) / ((n - 1) * n)


def _spatial_variance(stack: Stack, shading: bool = False) -> float:
    """Variance over the pixels of their temporal mean: of the average frame, less the temporal noise left in it.

    Args:
        stack: The frames.
        shading: Take out a parabola over rows and columns first: how a lens or a lamp fades towards the corners.
    """
    mean = average(stack)
    smooth = parabola(mean.shape) if shading else np.ones((mean.size, 1))
    rest = mean.ravel() - smooth @ np.linalg.lstsq(smooth, mean.ravel(), rcond=None)[0]
    return float(rest @ rest) / (rest.size - smooth.shape[1]) - temporal_variance(stack) / len(stack.frames)


def parabola(shape: tuple[int, ...]) -> Array:
    """The six surfaces 1, x, y, x**2, xy, y**2 over a frame, [pixels, 6]."""
    y, x = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij"))
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1)


def _line(stacks: Sequence[Stack], quantity: Callable[[Stack], float]) -> tuple[float, float]:
    """Value at zero exposure time, and slope per second; weighted for errors that grow with the value."""
    values = np.array([quantity(s) for s in stacks])
    # A value of 0 (no noise at all) would get infinite weight
    slope, start = np.polyfit([s.time for s in stacks], values, 1, w=1 / np.maximum(values, 1e-3))
    return float(start), float(slope)


def _linearity(light: Array, signal: Array, peak: float) -> tuple[float, float]:
    """Bend b of signal = x - b x**2, 1/DN, x proportional to light; largest relative deviation from a straight line."""
    inside = (signal >= 0.05 * peak) & (signal <= 0.95 * peak)
    require(inside.sum() >= 3, "flat", "three stacks or more from 5 % to 95 % of saturation", int(inside.sum()))
    x, y = light[inside], signal[inside]
    response, bend = np.linalg.lstsq(np.stack([x, -(x**2)], 1) / y[:, None], np.ones_like(y), rcond=None)[0]
    if np.ptp(x) == 0:
        return 0.0, np.inf  # no line goes through different signals of one light
    slope, start = np.polyfit(x, y, 1, w=1 / y)
    straight = slope * x + start
    return float(bend / response**2), float(np.abs(y / straight - 1).max())


def noise_parts(stacks: Sequence[Stack], at_zero_time: float) -> tuple[float, float, float]:
    """Temporal variance of rows, of columns and of single pixels in the dark, DN**2.

    Row means vary by the row noise and by the pixel noise that remains after averaging; the difference of two frames is
    free of the fixed pattern.
    """
    rows, columns = [], []
    for stack in stacks:
        frames = np.asarray(stack.frames, np.float64)
        for first, second in zip(frames[:-1:2], frames[1::2], strict=False):
            difference = (first - second) / np.sqrt(2)
            h, w = difference.shape
            by_row, by_column = difference.mean(1).var(ddof=1), difference.mean(0).var(ddof=1)
            pixel = (difference.var(ddof=1) - by_row - by_column) / (1 - 1 / w - 1 / h)
            rows.append(by_row - pixel / w)
            columns.append(by_column - pixel / h)
    row, column = max(float(np.mean(rows)), 0.0), max(float(np.mean(columns)), 0.0)
    return row, column, at_zero_time - row - column


def _hot_pixels(dark: Sequence[Stack]) -> tuple[NDArray[np.bool_], float]:
    """Pixels whose signal grows much faster in the dark than other pixels', [h, w], and by how much, DN/s.

    Heavy tails of the read noise and telegraph pixels reach as far by chance, but with as much noise of their own.
    """
    # Shortest and longest time; of several stacks of one time, the stack of most frames.
    first = min(dark, key=lambda s: (s.time, -len(s.frames)))
    last = max(dark, key=lambda s: (s.time, len(s.frames)))
    grown = average(last) - average(first)
    grown -= np.median(grown)
    # Where noise is below a DN, most pixels have grown by exactly as much, and any other would be hot
    spread = max(1.4826 * float(np.median(np.abs(grown))), QUANTISATION**0.5)
    own = np.sqrt(_variance_of_average(first) + _variance_of_average(last))
    hot = grown > HOT * np.maximum(spread, own)
    return hot, float(grown[hot].mean()) / (last.time - first.time) if hot.any() else 0.0


def _without(stack: Stack, hot: NDArray[np.bool_]) -> Stack:
    """The stack with another pixel, the next that is not hot, in the place of each hot one."""
    good, bad = np.flatnonzero(~hot), np.flatnonzero(hot)
    if len(bad) == 0:
        return stack
    frames = np.reshape(stack.frames, (len(stack.frames), -1)).copy()
    frames[:, bad] = frames[:, good[np.searchsorted(good, bad) % len(good)]]
    return replace(stack, frames=frames.reshape(np.shape(stack.frames)))


def _largest(stacks: Sequence[Stack]) -> Stack:
    return max(stacks, key=lambda s: (len(s.frames), -s.time))


def _prnu(dark: Sequence[Stack], flat: Sequence[Stack], dark_line: tuple[float, float], bend: float) -> float:
    most = max(len(s.frames) for s in flat)
    bright = max((s for s in flat if len(s.frames) == most), key=_mean)
    shade = min(dark, key=lambda s: (abs(s.time - bright.time), -len(s.frames)))
    signal = np.array([_mean(bright) - dark_line[0] - dark_line[1] * bright.time])
    straight, slope = _straightened(signal, bend)
    variance = _spatial_variance(bright, shading=True) - _spatial_variance(shade, shading=True)
    return _root(variance) / float((straight * slope)[0])


def _root(variance: float) -> float:
    """Square root of an estimated variance, which noise can make negative where the true one is 0."""
    return float(np.sqrt(max(variance, 0.0)))


@dataclass(frozen=True, kw_only=True)
class GainFit:
    """gain = slope ISO + start, DN/e-, over the ISOs that a camera reads with one gain of its pixels."""

    isos: tuple[float, float]  # the first and the last that were measured
    slope: float  # DN/e- per ISO
    start: float  # DN/e-
    residual: float  # largest relative deviation of a measured gain; 0 of one or two, which no line can miss

    def gain(self, iso: float) -> float:
        """At any ISO between them, DN/e-."""
        return self.slope * iso + self.start


def gain_fits(isos: Sequence[float], gains: Sequence[float], sigmas: Sequence[float]) -> list[GainFit]:
    """Gain as a function of ISO: one line, or two where the camera switches the gain of its pixels in between.

    Args:
        isos: Rising.
        gains: Measured at each, DN/e-.
        sigmas: Read noise at each, e-.
    """
    iso, gain = np.array(isos, np.float64), np.array(gains, np.float64)
    step = _dual_gain_step(gain, np.array(sigmas, np.float64))
    fits = []
    for side in (slice(0, step), slice(step, None)) if step else (slice(None),):
        x, y = iso[side], gain[side]
        slope, start = np.polyfit(x, y, 1, w=1 / y) if len(x) > 1 else (y[0] / x[0], 0.0)
        miss = float(np.abs((slope * x + start) / y - 1).max()) if len(x) > 2 else 0.0
        fits.append(GainFit(isos=(x[0].item(), x[-1].item()), slope=float(slope), start=float(start), residual=miss))
    return fits


def _dual_gain_step(gain: Array, sigma: Array) -> int | None:
    """Index of the first ISO at the high gain of the pixels; None if one gain explains the read noise of all.

    Noise before the amplifier is constant in electrons and noise behind it in DN: with one gain of the pixels the
    variance is a + b / gain**2, e-**2, both >= 0, and the read noise in DN never falls with the ISO.
    """

    def misses(part: slice) -> Array:
        basis = np.stack([np.ones_like(gain[part]), gain[part] ** -2], 1) / np.maximum(sigma[part, None], 1e-9) ** 2
        return np.asarray(basis @ scipy.optimize.nnls(basis, np.ones(len(basis)))[0] - 1)

    whole = misses(slice(None))
    if len(gain) < 2 or np.abs(whole).max() <= STEP:
        return None
    totals = [
        float(np.square(np.append(misses(slice(0, k)), misses(slice(k, None)))).sum()) for k in range(1, len(gain))
    ]
    # Of few ISOs several splits fit: then where the noise falls most
    best = 1 + min(range(len(totals)), key=lambda k: (round(totals[k], 2), sigma[k + 1] / sigma[k]))
    better = totals[best - 1] < float(np.square(whole).sum()) / 4
    return best if better and sigma[best] < sigma[best - 1] else None
