"""The chains of a training iteration beside rendering: activation, the loss, and the step of all parameters."""

# mypy: allow-untyped-defs

from ..compiler import kernel
from ..raster import project_backward
from ..training import activations, optimizer, photometric
from .stages import shared

GRAIN_VALUES = 4096
GRAIN_ROWS = 8  # of an image
GRAIN_BAND = 48  # rows of a band, that needs ten rows above and below it too

_activate, _activate_backward = shared(activations.forward), shared(activations.backward)
_absolute, _structure = shared(photometric.absolute), shared(photometric.structure)
_project, _find_large = shared(project_backward.backward), shared(optimizer.find_large)
_adam, _adam_harmonics = shared(optimizer.adam), shared(optimizer.adam_harmonics)


@kernel
def activate(control, threads, log_scales, logit_opacities, scales, opacities, scale_sums, opacity_sums):
    """Scales and opacities of flat arrays, with their sums by blocks of `activations.BLOCK`."""
    _activate(control, 0, threads, len(scale_sums), 1, False, log_scales, scales, scale_sums)
    _activate(control, 1, threads, len(opacity_sums), 1, True, logit_opacities, opacities, opacity_sums)


@kernel
def compare(control, threads, image, target, channels, weights, l1_weight, ssim_weight, score_sums, l1_sums, v_image):
    """L1 and SSIM of two images [H, W * C], and the gradient of the first; see `photometric`."""
    height = len(image)
    _absolute(control, 0, threads, height, GRAIN_ROWS, image, target, l1_weight, l1_sums, v_image)
    if ssim_weight != 0:
        _structure(
            control, 1, threads, height, GRAIN_BAND, image, target, channels, weights, ssim_weight, score_sums, v_image
        )


@kernel
def step(
    control, threads, shape, camera, center, degree, depth_channel, v_rows, slots, v_shape, v_features, v_camera,
    shares, v_trained, trained, first, second, rates, sh, sh_rates, pull, numbers, found,
):  # fmt: skip
    """Gradients of all parameters from the gradient rows, and an Adam step; unless one is LARGE: then found[0] is set.

    Args:
        control: Of `stages`.
        threads: How many take part.
        shape: means, quats, scales, opacities.
        camera: As `project` wants it.
        center: Of the camera in the world [3].
        degree: Of the harmonics.
        depth_channel: Where depth is, or -1.
        v_rows: Gradient rows, flat.
        slots: Where a Gaussian's rows are [N + 1].
        v_shape: Gradients of the shape, written.
        v_features: Of the colours [N, 3], written.
        v_camera: Partial sums of the gradients of the camera and of its centre, or empty.
        shares: Gradient of each scale and each opacity from the regularisers.
        v_trained: Gradients of log scales and logit opacities, flat, written.
        trained: means, quats, log_scales, logit_opacities, all flat; changed in place.
        first: Their first moments.
        second: Their second moments.
        rates: Their learning rates.
        sh: The coefficients [N, 3 K] and their first and second moments.
        sh_rates: One for each column of sh that is trained.
        pull: Weights of the penalty of each Gaussian's coefficients, or empty, and its partial sums.
        numbers: beta1, beta2, correction1, correction2, eps as `optimizer` wants them.
        found: [1] int64.
    """
    means, quats, scales, opacities = shape
    v_means, v_quats, v_scales, v_opacities = v_shape
    flat_scales, v_flat_scales = scales.reshape(-1), v_scales.reshape(-1)
    beta1, beta2, correction1, correction2, eps = numbers
    n = len(means)
    blocks = -(-n // project_backward.BLOCK)
    _project(
        control, 0, threads, blocks, 1, means, quats, scales, opacities, camera, v_rows, slots, 1, depth_channel,
        v_means, v_quats, v_scales, v_opacities, v_features, v_camera[0],
    )  # fmt: skip
    _find_large(control, 1, threads, 3 * n, GRAIN_VALUES, v_means.reshape(-1), found)
    _find_large(control, 2, threads, 4 * n, GRAIN_VALUES, v_quats.reshape(-1), found)
    _find_large(control, 3, threads, 3 * n, GRAIN_VALUES, v_flat_scales, found)
    _find_large(control, 4, threads, n, GRAIN_VALUES, v_opacities, found)
    _find_large(control, 5, threads, 3 * n, GRAIN_VALUES, v_features.reshape(-1), found)
    _find_large(control, 6, threads, 3 * n, GRAIN_VALUES, flat_scales, found)
    _find_large(control, 7, threads, v_camera[0].size, GRAIN_VALUES, v_camera[0].reshape(-1), found)
    if found[0]:
        return
    _adam_harmonics(
        control, 8, threads, blocks, 1, project_backward.BLOCK, degree, means, sh[0], sh[1], sh[2], center,
        v_features, v_means, v_camera[1], pull[0], pull[1], sh_rates, beta1, beta2, correction1, correction2, eps,
    )  # fmt: skip
    parts = -(-3 * n // activations.BLOCK), -(-n // activations.BLOCK)
    _activate_backward(control, 9, threads, parts[0], 1, False, flat_scales, v_flat_scales, shares[0], v_trained[0])
    _activate_backward(control, 10, threads, parts[1], 1, True, opacities, v_opacities, shares[1], v_trained[1])
    gradients = v_means.reshape(-1), v_quats.reshape(-1), v_trained[0], v_trained[1]
    for i in range(4):
        _adam(
            control, 11 + i, threads, len(gradients[i]), GRAIN_VALUES, trained[i], gradients[i], first[i], second[i],
            rates[i], beta1, beta2, correction1, correction2, eps,
        )  # fmt: skip
