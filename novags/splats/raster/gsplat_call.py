"""Arguments of `gsplat.rasterization` that change nothing here, or that `rasterize` refuses, and why."""

from typing import Any

_PINHOLE = "cameras here are pinholes without distortion or rolling shutter: undistort the pictures first"
_EVAL3D = "Gaussians are projected to the image here, not intersected along rays in 3D"
_COLORS = "more channels go into colors [N, D] with sh_degree=None"
# By name: the reason. gsplat's default, which passes, is None or False unless DEFAULTS has it. Up to gsplat 1.6.
REFUSED = {
    "distributed": "one process renders all Gaussians here",
    "with_ut": _EVAL3D, "with_eval3d": _EVAL3D, "ut_params": _EVAL3D, "return_normals": _EVAL3D, "rays": _EVAL3D,
    "renderer_config": _EVAL3D, "global_z_order": "Gaussians are sorted by camera z here, not by distance",
    "radial_coeffs": _PINHOLE, "tangential_coeffs": _PINHOLE, "thin_prism_coeffs": _PINHOLE, "ftheta_coeffs": _PINHOLE,
    "lidar_coeffs": _PINHOLE, "external_distortion_coeffs": _PINHOLE, "rolling_shutter": _PINHOLE,
    "viewmats_rs": _PINHOLE, "extra_signals": _COLORS, "extra_signals_sh_degree": _COLORS,
}  # fmt: skip
DEFAULTS = {"global_z_order": True}
CAMERA_MODELS = ("pinhole",)  # of gsplat's: "pinhole", "ortho", "fisheye", "ftheta"
HIT_DISTANCES = ("d", "Ed", "RGB-d", "RGB-Ed")
TILE_SIZES = (None, 16)
RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
RASTERIZE_MODES = ("classic", "antialiased")


def check_others(others: dict[str, Any]) -> None:
    """Raise for arguments of gsplat's that are asked for and not supported here.

    Raises:
        TypeError: For a name that gsplat does not know either.
        ValueError: Naming the argument and the reason.
    """
    for name, value in others.items():
        if name not in REFUSED:
            raise TypeError(f"rasterize() got an unexpected keyword argument {name!r}")
        # the enumeration of shutters is gsplat's own, which need not be installed
        asked = value is not None and value is not DEFAULTS.get(name, False) and getattr(value, "name", "") != "GLOBAL"
        if asked:
            shown = f"a {type(value).__name__}" if hasattr(value, "shape") else repr(value)
            raise ValueError(f"{name}={shown} is not supported by rasterize: {REFUSED[name]}")


def check_choices(
    *, render_mode: Any, rasterize_mode: Any, camera_model: Any, tile_size: Any, channel_chunk: Any, sparse_grad: bool,
    packed: bool,
) -> None:  # fmt: skip
    """Raise ValueError for a choice of gsplat's that is not supported here, naming it and the reason."""
    if camera_model not in CAMERA_MODELS:
        raise ValueError(f"camera_model={camera_model!r} is not supported by rasterize: {_PINHOLE}")
    if render_mode in HIT_DISTANCES:
        raise ValueError(f"render_mode={render_mode!r} is not supported by rasterize: {_EVAL3D}; use its D or ED")
    if tile_size not in TILE_SIZES:
        raise ValueError(f"tile_size={tile_size!r} is not supported by rasterize: the CPU kernels are built for 16")
    known = {"render_mode": (render_mode, RENDER_MODES), "rasterize_mode": (rasterize_mode, RASTERIZE_MODES)}
    for name, (value, choices) in known.items():
        if value not in choices:
            raise ValueError(f"{name} must be one of {choices}, got {value!r}")
    if not isinstance(channel_chunk, int) or channel_chunk < 1:
        raise ValueError(f"channel_chunk must be at least 1, got {channel_chunk!r}")
    if sparse_grad and not packed:
        raise ValueError("sparse_grad=True needs packed=True, as in gsplat, got packed=False")
