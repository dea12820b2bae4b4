"""Assertions with known truth. A wrong result of the code under test is an `AssertionError` with the numbers; a bound
on something that there is not is a `ValueError`.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from novags.testing.known import PosedViews

SMALLER_IS_BETTER = ("abs_rel", "floaters", "rotation_deg", "centre_error")  # beside the rows of METRICS that say so
WHITE = 0.97  # quantile of the true light that counts as white: the raw data's own is far above all that is dark
GROUPS = 4  # of pixels by brightness, in each of which the noise must fit


def assert_scores(
    views: PosedViews, pictures: ArrayLike | Path | str, against: Literal["lit", "clean", "linear"] = "lit",
    **bounds: float,
) -> dict[str, float | None]:  # fmt: skip
    """Pictures of the views must score at least (PSNR, SSIM) or at most (FLIP, ΔE, LPIPS) this, on average.

    Args:
        views: The views they show: `dark.test`.
        pictures: [C,h,w,3], floats in 0..1, uint8 or uint16, encoded like their reference; or a folder of files named
            like the views. Files of 8 bits are always sRGB-encoded.
        against: "lit": the views in good light; "clean": the dark exposures without noise, both sRGB-encoded;
            "linear": these in linear light, after one gain for all views, exposed so that few of their values are
            beyond white.
        bounds: psnr, aligned_psnr, tone_aligned_psnr, ssim, aligned_ssim, tone_aligned_ssim, flip, delta_e, lpips;
            linear_psnr alone for "linear". See `novags help scores`.

    Returns:
        All mean scores.
    """
    __tracebackhide__ = True
    from novags.testbed.metrics import networks
    from novags.testbed.metrics.images import image_scores
    from novags.testbed.metrics.linear import exposure_gain, linear_psnr

    images = _images(views, pictures, linear=against == "linear")
    if against not in ("lit", "clean", "linear"):
        raise ValueError(f"against must be lit, clean or linear, got {against!r}")
    truth = views.clean_linear if against == "linear" else getattr(views, against)
    scores: list[dict[str, Any]]
    if against == "linear":
        white = float(np.quantile(truth, WHITE))
        if not white > 0:
            raise ValueError("the scene is black to 97 %: it has no linear score")
        with _blamed_on("pictures"):
            gain = exposure_gain(zip(images, truth, strict=True), white)
        scores = [{"linear_psnr": linear_psnr(*pair, gain, white)} for pair in zip(images, truth, strict=True)]
    else:
        scores = [dict(image_scores(*pair, networks() & bounds.keys())) for pair in zip(images, truth, strict=True)]
    return _hold(f"against {against}", views, scores, bounds)


def assert_depth(
    views: PosedViews, depth: ArrayLike, alpha: ArrayLike | None = None, **bounds: float
) -> dict[str, float | None]:
    """Depth maps of the views must be as good as this, on average.

    Args:
        views: The views they belong to: `dark.test`.
        depth: z-depth [C,h,w] in the units of the scene; 0, inf or nan where there is nothing.
        alpha: Opacity [C,h,w] in 0..1; 1 everywhere if not given.
        bounds: abs_rel (mean relative error, at most), within_5_percent (share of pixels, at least), coverage (share
            of pixels that have a depth, at least), floaters (opacity before the true surface, at most).

    Returns:
        All mean scores.
    """
    __tracebackhide__ = True
    from novags.testbed.metrics.geometry import geometry_scores

    shape = (len(views), views.height, views.width)
    z = _numbers("depth", depth, shape)
    opacity = np.ones(shape) if alpha is None else _numbers("alpha", alpha, shape)
    with _blamed_on("depth or alpha"):
        scores = [dict(geometry_scores(*view)) for view in zip(z, opacity, views.depth, strict=True)]
    for name, score, true in zip(views.names, scores, views.depth, strict=True):
        judged = any(score.get(bound, 0) is None for bound in bounds)
        assert not (judged and np.isfinite(true).any()), f"view {name} has no depth where the scene has surfaces"
    return _hold("of the depth", views, scores, bounds)


def assert_poses(
    views: PosedViews, viewmats: ArrayLike, *, rotation_deg: float, centre_error: float, registered: float = 1.0
) -> dict[str, float | None]:
    """Estimated cameras must be as close to the true ones as this, after the best similarity between the two worlds.

    Args:
        views: Of which they are the cameras: `dark.train`.
        viewmats: World-to-camera [C,4,4], rigid, in any world; nan for a view without a camera.
        rotation_deg: Most that cameras may be turned, on average, degrees.
        centre_error: Most that their centres may be off, on average, in true scene extents.
        registered: Least share of the views that have a camera.

    Returns:
        rotation_deg, centre_error and registered.
    """
    __tracebackhide__ = True
    import torch

    from novags.cameras.align import align

    found = _numbers("viewmats", viewmats, (len(views), 4, 4))
    there: NDArray[np.bool_] = np.asarray(np.isfinite(found).reshape(len(views), 16).all(axis=1))
    share = float(there.mean())
    lost = [name for name, known in zip(views.names, there.tolist(), strict=True) if not known]
    assert share >= registered, (
        f"{share:.0%} of the views have a camera, at least {registered:.0%} must; none: {', '.join(lost)}"
    )
    assert np.allclose(found[there][:, 3], (0, 0, 0, 1)), "the last row of a viewmat must be 0 0 0 1"
    true = torch.from_numpy(views.viewmats[there])
    with _blamed_on("viewmats"):
        alignment = align(torch.from_numpy(found[there]), true)
    names = [name for name, known in zip(views.names, there.tolist(), strict=True) if known]
    turned, moved = alignment.rotation_deg.tolist(), alignment.centre_error.tolist()
    scores = [{"rotation_deg": a, "centre_error": b} for a, b in zip(turned, moved, strict=True)]
    bounds = {"rotation_deg": rotation_deg, "centre_error": centre_error}
    return {**_hold("of the cameras", names, scores, bounds), "registered": share}


def assert_noise(views: PosedViews, frames: ArrayLike, *, sigmas: float = 5.0) -> None:
    """Raw frames must have the mean and the variance that the camera's noise model states for every pixel.

    The residuals (frame - mean) / sd of all pixels, and of each quarter of them by brightness, must have mean 0 and
    variance 1 within their standard error, which the capture's own exposures tell: rows may have noise in common.

    Args:
        views: Which exposures: `dark.train` or `dark.test`.
        frames: Digital numbers shaped like `views.raw`: of a simulated camera, say.
        sigmas: Standard errors that are allowed.
    """
    __tracebackhide__ = True
    dn = _numbers("frames", frames, views.raw.shape)
    assert np.isfinite(dn).all(), "frames must be finite"
    mean, variance = views.mean_dn.astype(np.float64), views.variance_dn.astype(np.float64)
    noisy = variance > 1e-6  # DN²; smaller variances belong to saturated pixels, and dividing by them would blow up
    still = float(np.abs(dn - mean)[~noisy].max(initial=0.0))
    assert still <= 0.5, f"pixels without noise (saturated ones) are up to {still:.3g} DN off their mean"
    sd = np.sqrt(np.where(noisy, variance, 1.0))
    z, known = (dn - mean) / sd, (views.raw - mean) / sd  # the capture's own exposures tell how far z may scatter
    edges = np.quantile(mean[noisy], np.linspace(0, 1, GROUPS + 1))
    for low, high in [(edges[0], edges[-1]), *zip(edges[:-1], edges[1:], strict=True)]:
        chosen = noisy & (mean >= low) & (mean <= high)
        for what, power, expected in (("mean", 1, 0.0), ("variance", 2, 1.0)):
            found, error = float((z**power)[chosen].mean()), _error_of_mean(known**power, chosen)
            assert abs(found - expected) <= sigmas * error, (
                f"the {what} of (frame - mean) / sd is {found:.4g} where the mean is {low:.5g} to {high:.5g} DN, and "
                f"must be {expected:g} within {sigmas:g} standard errors of {error:.2g}"
            )


def _error_of_mean(values: NDArray, chosen: NDArray[np.bool_]) -> float:
    """Standard error of the mean of the chosen values [C,h,w] or [C,h,w,3]: rows are independent, pixels need not be.

    Never less than for independent pixels, of which a few rows could otherwise promise too much.
    """
    rows = tuple(range(2, values.ndim))
    sums, counts = np.where(chosen, values, 0.0).sum(rows).ravel(), chosen.sum(rows).ravel()
    total, mean = counts.sum(), values[chosen].mean()
    by_rows = np.sqrt(((sums - mean * counts) ** 2).sum()) / total
    return float(max(by_rows, values[chosen].std() / np.sqrt(total)))


def _images(
    views: PosedViews, pictures: ArrayLike | Path | str, *, linear: bool
) -> list[NDArray[np.float32]]:  # fmt: skip
    __tracebackhide__ = True
    if isinstance(pictures, Path | str):
        from novags.testbed.importing.pictures import find_renders, read_picture

        files = find_renders(Path(pictures), views.names).files
        return [read_picture(files[name], views.width, views.height, linear=linear).values for name in views.names]
    given = _array("pictures", pictures)
    whole = given.dtype.kind in "iub"
    assert not whole or given.dtype in (np.uint8, np.uint16), (
        f"pictures must be floats in 0..1, uint8 or uint16, got {given.dtype}"
    )
    largest = np.iinfo(given.dtype).max if whole else 1
    found = _numbers("pictures", given, (len(views), views.height, views.width, 3))
    assert np.isfinite(found).all(), f"pictures must be finite, {int((~np.isfinite(found)).sum())} values are not"
    return list((found / largest).astype(np.float32))


def _numbers(what: str, given: ArrayLike, shape: Sequence[int]) -> NDArray[np.float64]:
    __tracebackhide__ = True
    found = _array(what, given)
    assert found.shape == tuple(shape), f"{what} must be {list(shape)}, got {list(found.shape)}"
    return found.astype(np.float64)


def _array(what: str, given: Any) -> NDArray[Any]:
    """Any container of real numbers as an array: lists of tensors, and trained tensors, too."""
    __tracebackhide__ = True
    if hasattr(given, "detach"):  # a tensor of torch; its narrow floats are unknown to NumPy
        found = given.detach().cpu()
        return np.asarray(found.float() if found.is_floating_point() and found.element_size() < 4 else found)
    if isinstance(given, list | tuple):
        parts = [_array(what, part) for part in given]
        shapes = {part.shape for part in parts}
        assert len(shapes) <= 1, f"{what} must be of one shape, got {', '.join(map(str, sorted(shapes)))}"
        return np.stack(parts) if parts else np.zeros(0)
    array = np.asarray(given)
    assert array.dtype.kind in "biuf", f"{what} must be real numbers, got {array.dtype}"
    return array


@contextmanager
def _blamed_on(what: str) -> Iterator[None]:
    """Values that cannot be judged are wrong results of the code under test."""
    __tracebackhide__ = True
    try:
        yield
    except ValueError as wrong:
        raise AssertionError(f"{what}: {wrong}") from None


def _hold(
    what: str, views: PosedViews | Sequence[str], scores: Sequence[Mapping[str, Any]], bounds: Mapping[str, float]
) -> dict[str, float | None]:
    """The mean scores; they must lie within the bounds."""
    __tracebackhide__ = True
    from novags.testbed.metrics import METRICS
    from novags.testbed.metrics.images import mean_scores

    names = views.names if isinstance(views, PosedViews) else views
    mean: dict[str, float | None] = mean_scores([dict(view) for view in scores])
    for name, bound in bounds.items():
        if name not in mean:
            raise ValueError(f"unknown score {name!r} {what}: choose one of {', '.join(mean)}")
        if isinstance(bound, bool) or not isinstance(bound, int | float | np.number):
            raise ValueError(f"the bound of {name} must be a number, got {bound!r}")
        found = mean[name]
        assert found is not None, f"{name} {what} cannot be measured: there is nothing to see in the truth or no depth"
        least = METRICS[name].more if name in METRICS else name not in SMALLER_IS_BETTER
        sign = 1 if least else -1
        judged = [(sign * view[name], label) for view, label in zip(scores, names, strict=True)
                  if view[name] is not None]  # fmt: skip
        worst, where = min(judged)
        assert sign * found >= sign * bound, (
            f"{name} {what} is {found:.5g}, must be at {'least' if least else 'most'} {bound:g}; worst view {where}: "
            f"{sign * worst:.5g}"
        )
    return mean
