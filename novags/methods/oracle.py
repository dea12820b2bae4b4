"""The ceiling: fit the noise-free dark exposures, put through the enhancement that their noisy twins chose."""

import time
from pathlib import Path

from novags.methods.enhance_then_fit import NaiveConfig, Progress, fit_images
from novags.methods.enhancers.guided import enhance
from novags.methods.problem import MethodInput, MethodResult


def train(
    inputs: MethodInput, config: NaiveConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> MethodResult:
    """Reconstruct from what no real method can see.

    Args:
        inputs: As for `naive`, with `inputs.clean`.
        config: All choices; `config.fit.seed` and `config.fit.extent` are overridden by `inputs`.
        progress: As in `splats.fit`.
        checkpoint: As in `splats.fit`.

    Returns:
        MethodResult; `enhanced` and `targets` are the enhanced noise-free images. Seconds: "enhance" and "fit".

    Raises:
        ValueError: If the capture has no noise-free exposures.
    """
    if inputs.clean is None:
        raise ValueError("oracle needs the noise-free exposures (MethodInput.clean), this capture has none")
    started = time.perf_counter()
    _, params = enhance(inputs.dark, config.enhance)
    images, _ = enhance(inputs.clean, config.enhance, params)
    seconds = time.perf_counter() - started
    result = fit_images(inputs, images, config, progress, checkpoint)
    result.seconds = {"enhance": seconds, **result.seconds}
    return result
