"""How alike two pixels must be to be averaged, chosen from the data themselves.

An average of raw data has a bias, where pixels that look alike are not, and a variance. Both can be estimated without
the truth. For a datum y of variance v, and the average q of the others, of variance v_q,

    E (y - q)**2 = v + v_q + bias**2

The bias is common to all views. The variance is not: the fit to the averages of all views reduces it by a factor VIEWS.
Too wide a window therefore costs more than a single picture would show, and the best h is smaller than for one picture.

All this holds for independent noise. Where neighbours share it, y and q do too, and their difference says nothing of
the bias: h is then a share of the noise.
"""

import math

from torch import Tensor

from novags.methods.nova_plus.average import averages
from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.tone import ToneCurve

VIEWS = 3.0  # the factor by which the fit to all averages reduces their variance
STEP = math.sqrt(2)
SMALLEST, LARGEST = 0.007, 0.32  # in tone
JUDGES = 4  # views that are examined
# Of the RMS noise, in tone. The best h of demosaiced pictures of three scenes at 5 to 80 electrons, found by the truth,
# is 0.10 to 0.25 of it; independent data choose 0.17 to 0.25 by themselves.
SHARE_OF_NOISE = 1 / 6


def choose_bandwidth(guide: Tensor, data: LightMeasurements, curve: ToneCurve) -> tuple[float, list[dict[str, float]]]:
    """The h of `averages` at which bias**2 + variance / VIEWS is least, between the steps of a grid.

    Of data that share their noise, `SHARE_OF_NOISE` of it.

    Args:
        guide: Tones of the training views [C, H, W, 3].
        data: The measurements.
        curve: From tones to light.

    Returns:
        h, and the findings of each step: "h", "bias2" and "variance", in squared tone; nothing for shared noise.
    """
    if data.shared:
        total, count = 0.0, 0
        for tones, light in zip(guide, data.light, strict=True):
            noise = (data.noise(curve.light(tones)) / curve.slope(tones).square())[~light.isnan()]
            total, count = total + float(noise.double().sum()), count + len(noise)
        rms = math.sqrt(total / count)
        return min(max(SHARE_OF_NOISE * rms, SMALLEST), LARGEST), []
    views = sorted({round(i * (len(guide) - 1) / (JUDGES - 1)) for i in range(JUDGES)})
    some = data.some(views)
    found = []
    for step in range(1 + math.floor(math.log(LARGEST / SMALLEST, STEP))):
        h = SMALLEST * STEP**step
        bias2, variance = errors_of_average(guide[views], some, curve, h)
        found.append({"h": h, "bias2": bias2, "variance": variance})
        if len(found) > 2 and bias2 > 4 * min(_risk(f) for f in found):
            break  # it only grows from here
    best = min(range(len(found)), key=lambda i: _risk(found[i]))
    shift = _vertex(*(_risk(f) for f in found[best - 1 : best + 2])) if 0 < best < len(found) - 1 else 0.0
    return found[best]["h"] * STEP**shift, found


def errors_of_average(guide: Tensor, data: LightMeasurements, curve: ToneCurve, h: float) -> tuple[float, float]:
    """Squared bias and variance of the guided averages, means over the data in squared tone.

    Args:
        guide: Tones [C, H, W, 3].
        data: The measurements.
        curve: From tones to light.
        h: As in `averages`.
    """
    fitted = data.fitted
    sums = averages(guide, fitted, h=h, patch=1, own=False)
    slope = curve.slope(guide)
    noise = data.noise(curve.light(guide)) / slope.square()
    residual = ((data.light - sums.mean(data.light)) / slope).square()
    # with the datum itself among the W others, the average is pulled back towards the truth by W / (W + 1)
    pulled = (sums.weights / (sums.weights + 1)).square()
    bias2 = pulled * (residual - noise * (1 + sums.variance))
    variance = noise * (sums.squares + 1) / (sums.weights + 1).square()
    there = ~fitted.isnan()
    if not there.any():
        return 0.0, math.inf
    return float(bias2[there].double().mean()), float(variance[there].double().mean())


def _risk(found: dict[str, float]) -> float:
    return found["bias2"] + found["variance"] / VIEWS


def _vertex(left: float, middle: float, right: float) -> float:
    """Where the parabola through three equally spaced values is least, -1/2..1/2 of a step from the middle one."""
    bend = left - 2 * middle + right
    return 0.0 if bend <= 0 else 0.5 * (left - right) / bend
