"""Signal over noise of a capture's raw frames, in decibels.

SNR = 10 log10(sum s**2 / sum n**2) over all pixels of all views, with s = clean - dark, the digital numbers that light
alone gives, and n**2 = variance + (mean - clean)**2, the expected squared error of one exposure: its temporal variance
and the square of its fixed pattern. Below 0 dB the noise has more power than the signal. It is our own definition:
the literature on reconstruction from dark raw gives figures, and not always a formula.
"""

from math import log10

import numpy as np

from novags.testbed.folders.capture import Capture

FORMULA = (
    "`snr_db` is 10 log10 of the sum of (clean - dark)^2 over the sum of variance + (mean - clean)^2, over all raw "
    "pixels of all views of a capture: the power of the signal over the power of the noise, fixed pattern included; "
    "`dark` is the mean without light"
)


def snr_db(capture: Capture) -> float:
    """The SNR of a simulated capture, dB.

    Raises:
        ValueError: If a sum is 0, of a scene without light or of frames that are saturated everywhere.
    """
    signal = noise = 0.0
    dark = dark_dn(capture)
    for i in range(len(capture.names)):
        clean, mean, variance = (np.float64(capture.truth(i, kind)) for kind in ("clean", "mean", "variance"))
        signal += float(np.sum((clean - dark) ** 2))
        noise += float(np.sum(variance + (mean - clean) ** 2))
    for what, power, cause in (("signal", signal, "the scene has no light"), ("noise", noise, "all is saturated")):
        if not power > 0:
            raise ValueError(f"{capture.path}: the {what} must have power > 0 for an SNR in dB, got {power:g} DN**2: "
                             f"{cause}; leave this scene or light out")  # fmt: skip
    return 10 * log10(signal / noise)


def dark_dn(capture: Capture) -> float:
    """Mean digital number without light: the black level, and the dark current if it is simulated. DN."""
    sensor, made_of = capture.sensor, capture.record.simulated
    assert sensor is not None
    assert made_of is not None
    effects = made_of.plan["effects"] if made_of.plan else []
    if any(effect["name"] == "dark_current" and not effect["on"] for effect in effects):
        return float(sensor.black_level)
    return sensor.black_level + sensor.gain * sensor.dark_e(capture.record.exposure)
