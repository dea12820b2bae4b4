"""Checks of the arguments of `rasterize`. Every message names the tensor, the rule, the value found and its place."""

from numbers import Integral
from typing import Any, NoReturn

import torch
from torch import Tensor

from ..sh import n_coefficients

OF_CAMERAS = ("viewmats", "Ks", "backgrounds")


def check_shapes(tensors: dict[str, Tensor], sh_degree: int | None) -> None:
    """Raise ValueError unless shapes, dtypes and devices agree; `tensors` by argument name of `rasterize`."""
    for name, sizes in (("means", "[N, 3]"), ("viewmats", "[C, 4, 4]")):
        if tensors[name].ndim == 0:
            raise ValueError(f"{name} must have shape {sizes}, got []")
    n, c = len(tensors["means"]), len(tensors["viewmats"])
    want: dict[str, tuple[int, ...]] = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
    want |= {"covars": (n, 3, 3), "viewmats": (c, 4, 4), "Ks": (c, 3, 3)}
    for name in ("quats", "scales"):
        if name not in tensors and "covars" not in tensors:
            raise ValueError(f"{name} must be given, or covars in place of quats and scales, got None")
    for name, shape in ((name, shape) for name, shape in want.items() if name in tensors):
        if tensors[name].shape != shape:
            raise ValueError(f"{name} must have shape {list(shape)}, got {list(tensors[name].shape)}")
    if c == 0:
        raise ValueError("viewmats must hold at least one camera, got [0, 4, 4]")
    colors = tensors["colors"]
    if colors.ndim == (3 if sh_degree is None else 4):
        if len(colors) != c:
            raise ValueError(f"colors must be one for all or [C={c}, N, ...], got {list(colors.shape)}")
        colors = colors[0]
    if sh_degree is None:
        if colors.ndim != 2 or len(colors) != n or colors.shape[1] == 0:
            raise ValueError(f"colors must be [N={n}, D] when sh_degree is None, got {list(colors.shape)}")
    elif not isinstance(sh_degree, Integral) or sh_degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_degree must be 0, 1, 2, 3 or None, got {sh_degree}")
    elif colors.ndim != 3 or len(colors) != n or colors.shape[2] != 3 or colors.shape[1] < (sh_degree + 1) ** 2:
        k = (sh_degree + 1) ** 2
        raise ValueError(f"colors must be [N={n}, K >= {k}, 3] for sh_degree={sh_degree}, got {list(colors.shape)}")
    channels = colors.shape[1] if sh_degree is None else 3
    backgrounds = tensors.get("backgrounds")
    if backgrounds is not None and backgrounds.shape not in ((channels,), (c, channels)):
        raise ValueError(f"backgrounds must be [{channels}] or [{c}, {channels}], got {list(backgrounds.shape)}")
    for name, value in tensors.items():
        if value.dtype != colors.dtype or value.device != colors.device or not value.is_floating_point():
            raise ValueError(
                f"all tensors must share one float dtype and device: {name} is {value.dtype} on {value.device}, "
                f"colors is {colors.dtype} on {colors.device}"
            )


def check_numbers(width: Any, height: Any, near_plane: float, far_plane: float, eps2d: float, clip: float) -> None:
    """Raise ValueError unless the image has pixels, the planes are in order, and dilation and clip are not negative."""
    for name, value in (("width", width), ("height", height)):
        if not isinstance(value, Integral):
            raise ValueError(f"{name} must be an integer, got {value!r}")
    if width < 1 or height < 1:
        raise ValueError(f"width and height must be at least 1 pixel, got {width} x {height}")
    if not 0 < near_plane < far_plane:
        raise ValueError(f"planes must satisfy 0 < near_plane < far_plane, got {near_plane} and {far_plane}")
    if not 0 <= eps2d < float("inf"):
        raise ValueError(f"eps2d must be finite and >= 0 px^2, got {eps2d}")
    if not 0 <= clip < float("inf"):
        raise ValueError(f"radius_clip must be finite and >= 0 pixels, got {clip}")


def check_input(
    tensors: dict[str, Tensor | None], sh_degree: int | None, render_mode: str, backend: str, values: bool
) -> None:
    """Raise ValueError for tensors, by argument name of `rasterize`, that are wrong; None: not given.

    The CPU kernels notice bad numbers of Gaussians in passing, and ask for `check_gaussians` only then.
    """
    given = {name: tensor for name, tensor in tensors.items() if tensor is not None}
    check_shapes(given, sh_degree)
    if not values:
        return
    check_camera(given)
    if backend != "numba":
        check_gaussians({**given, "colors": used_colors(given["colors"], sh_degree, render_mode.startswith("RGB"))})


def check_finite(tensors: dict[str, Tensor]) -> None:
    """Raise ValueError if any number is not finite."""
    for name, value in tensors.items():
        bad = int((~torch.isfinite(value)).sum())
        if bad:
            raise ValueError(f"{name} must be finite, got {bad} non-finite of {value.numel()} values")


def check_camera(tensors: dict[str, Tensor]) -> None:
    """Raise ValueError for numbers that are not finite, or a camera other than a pinhole without skew."""
    check_finite({name: tensors[name] for name in ("viewmats", "Ks", "backgrounds") if name in tensors})
    Ks = tensors["Ks"]
    focal = Ks[:, (0, 1), (0, 1)]
    if (focal <= 0).any():
        raise ValueError(f"Ks must have positive focal lengths, got {focal.tolist()}")
    fixed = Ks[:, (0, 1, 2, 2, 2), (1, 0, 0, 1, 2)]
    if (fixed != fixed.new_tensor([0, 0, 0, 0, 1])).any():
        raise ValueError(f"Ks must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], skew is not supported, got {Ks.tolist()}")
    last = tensors["viewmats"][:, 3]
    if ((last - last.new_tensor([0, 0, 0, 1])).abs() > 1e-6).any():  # an inverse may leave a rounding error there
        raise ValueError(f"viewmats must end in [0, 0, 0, 1] (transposed?), got {last.tolist()}")


def used_colors(colors: Tensor, sh_degree: int | None, with_color: bool) -> Tensor:
    """The rendered part of the colours [N, D] or [N, K, 3]. The rest may hold anything, and is not checked."""
    if not with_color:
        return colors[..., :0]
    return colors if sh_degree is None else colors[..., : n_coefficients(sh_degree), :]


def ellipsoids(covars: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations wxyz [N, 4] and standard deviations [N, 3] of covariances [N, 3, 3].

    Raises:
        ValueError: If one is not finite, symmetric and positive semi-definite, or a gradient is wanted.
    """
    if covars.requires_grad and torch.is_grad_enabled():
        raise ValueError(
            "covars must not require a gradient on the CPU: its kernels take rotations and scales, and where scales "
            "are equal these have no gradient for the covariance; pass quats and scales, or use backend='gsplat'"
        )
    if covars.ndim != 3 or covars.shape[1:] != (3, 3):
        raise ValueError(f"covars must have shape [N, 3, 3], got {list(covars.shape)}")
    check_finite({"covars": covars})
    from scipy.spatial.transform import Rotation

    matrices = covars.detach().double()
    size = matrices.abs().amax((1, 2), keepdim=True)
    variances, axes = torch.linalg.eigh(matrices)
    # 1e-5: the rounding of a product in float32; less symmetric ones are not covariances
    wrong = ((matrices - matrices.mT).abs() > 1e-5 * size).any(-1).any(-1) | (variances < -1e-5 * size[:, 0]).any(-1)
    if wrong.any():
        first = int(torch.nonzero(wrong)[0, 0])
        raise ValueError(
            f"covars must be symmetric and positive semi-definite, got {covars[first].tolist()} at Gaussian {first}"
        )
    axes[:, :, 0] *= torch.linalg.det(axes)[:, None]
    xyzw = Rotation.from_matrix(axes.numpy()).as_quat() if len(axes) else axes.new_zeros(0, 4).numpy()
    quats = torch.from_numpy(xyzw)[:, (3, 0, 1, 2)]
    return quats.to(covars), variances.clamp_min(0).sqrt().to(covars)


def check_gaussians(tensors: dict[str, Tensor]) -> None:
    """Raise ValueError if any number is not finite, or a quaternion, scale or opacity is out of range."""
    check_finite({name: tensor for name, tensor in tensors.items() if name not in OF_CAMERAS})
    rules = {
        "quats": ("must not be zero", lambda quats: (quats == 0).all(-1)),
        "scales": ("must be >= 0", lambda scales: (scales < 0).any(-1)),
        "opacities": ("must lie in 0..1", lambda opacities: (opacities < 0) | (opacities > 1)),
    }
    for name, (rule, breaks) in rules.items():
        if name in tensors and (wrong := breaks(tensors[name])).any():
            first = int(torch.nonzero(wrong)[0, 0])
            value, count = tensors[name][first].tolist(), int(wrong.sum())
            raise ValueError(f"{name} {rule}, got {value} at Gaussian {first} ({count} of {len(wrong)})")


def refuse_overflow(tensors: dict[str, Tensor]) -> NoReturn:
    """Raise ValueError for finite numbers that are too large to be projected in float32; says where the largest are."""
    places = []
    for name, value in ((name, value) for name, value in tensors.items() if value.numel()):
        at = int(value.abs().argmax())
        index = torch.unravel_index(torch.tensor(at), value.shape)
        places.append(f"{name} {float(value.flatten()[at]):.3g} at {[int(i) for i in index]}")
    raise ValueError(
        "projection or colours overflow float32, values must be smaller; the largest are "
        f"{', '.join(places)}: remove that Gaussian or rescale the scene, or use backend='torch' in float64"
    )
