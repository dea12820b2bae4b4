"""Rendered geometry against analytic surfaces."""

from collections.abc import Callable
from typing import Any

import numpy as np

from simscenes import Rig
from simscenes.backend import using_variant
from simscenes.loading.load import build_scene
from simscenes.render.geometry import geometry_channels

Scene = Callable[[], dict[str, Any]]
Camera = Callable[..., Rig]


def analytic(rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distance, z-depth, normal and id (1 plane, 2 ball) of every pixel centre, in float64, from first principles."""
    x, y = np.meshgrid(np.arange(rig.width) + 0.5, np.arange(rig.height) + 0.5)
    directions = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(rig.Ks[0]).T
    c2w = np.linalg.inv(rig.viewmats[0])
    d = directions @ c2w[:3, :3].T
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    o = c2w[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        t_plane = -o[2] / d[..., 2]
        p = o + t_plane[..., None] * d
        t_plane = np.where((t_plane > 0) & (np.abs(p[..., :2]) <= 3).all(-1), t_plane, np.inf)
        b = d @ (o - [0, 0, 1])
        root = b**2 - (np.sum((o - [0, 0, 1]) ** 2) - 1)
        t_ball = np.where(root > 0, -b - np.sqrt(root), np.inf)
    t = np.minimum(t_plane, t_ball)
    ball = t_ball < t_plane
    normal = np.where(ball[..., None], o + np.where(np.isfinite(t), t, 0)[..., None] * d - [0, 0, 1], [0, 0, 1])
    z = t * (d @ c2w[:3, 2])
    return t, z, normal, np.where(np.isfinite(t), np.where(ball, 2, 1), 0)


def check_geometry(variant: str, scene: dict[str, Any], rig: Rig) -> None:
    with using_variant(variant) as mi:
        loaded = build_scene(scene, mi)
        assert variant in ("auto", loaded.variant.removesuffix("_rgb"))
        channels = geometry_channels(mi, loaded, rig, 0)
    t, z, normal, number = analytic(rig)
    names = np.array(["", *loaded.shapes])
    assert np.array_equal(names[channels["id"]], np.array(["", "plane", "ball"])[number])
    seen = number > 0
    assert 0.2 < seen.mean() < 1
    assert np.isinf(channels["Z"][~seen]).all()
    assert np.isinf(channels["distance"][~seen]).all()
    assert np.abs(channels["distance"][seen] / t[seen] - 1).max() < 1e-5
    assert np.abs(channels["Z"][seen] / z[seen] - 1).max() < 1e-5
    for name in ("N", "Ng"):
        found = np.stack([channels[f"{name}.{c}"] for c in "XYZ"], -1)
        assert np.abs(found[seen] - normal[seen]).max() < 2e-5
        assert not found[~seen].any()
    albedo = np.stack([channels[f"albedo.{c}"] for c in "RGB"], -1)
    assert np.allclose(albedo[seen], [0.6, 0.4, 0.2], atol=1e-6)
    assert len(np.unique(channels["material"][seen])) == 1


def test_geometry_equals_the_analytic_surfaces(ball_on_plane: Scene, view: Camera) -> None:
    check_geometry("auto", ball_on_plane(), view())


def test_geometry_is_the_same_in_a_scalar_variant(ball_on_plane: Scene, view: Camera) -> None:
    check_geometry("scalar", ball_on_plane(), view(21, 16))
