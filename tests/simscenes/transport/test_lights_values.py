"""How often each light is picked, from what it gives where: on tables made by hand, and under lamps worked out."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import Rig
from simscenes.backend import activate
from simscenes.loading.load import build_scene
from simscenes.rigs import intrinsics, look_at
from simscenes.transport import lights
from simscenes.transport.lights import light_weights

THREE: Any = [1, 2, 3]


@pytest.fixture
def weighed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The weights for given irradiances of each view [light, pixel]."""

    def weigh(views: list[Any], *, variant: str = "llvm_ad_rgb", count: int | None = None, media: Any = ()) -> Any:
        n = len(views[0]) if count is None else count

        def direct(mi: Any, loaded: Any, rig: Any, i: int, count: int, seed: int) -> Any:
            assert (count, seed) == (n, 5)
            return np.array(views[i], dtype=float)

        monkeypatch.setattr(lights, "_direct_light", direct)
        monkeypatch.setattr(lights, "media_in", lambda scene, mi: list(media))
        loaded: Any = SimpleNamespace(scene=SimpleNamespace(emitters=lambda: list(range(n))))
        return light_weights(SimpleNamespace(variant=lambda: variant), loaded, views, 5)  # type: ignore[arg-type]

    return weigh


def test_a_weight_is_the_root_mean_square_share_where_any_light_falls(
    weighed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two views of three points, one of them in the dark. A tenth of the picks is spread evenly."""
    views = [[[1, 0, 3], [3, 0, 0], [0, 0, 1]], [[0, 8, 2], [0, 0, 2], [5, 0, 0]]]
    shares = [(1 / 4, 3 / 4, 0), (3 / 4, 0, 1 / 4), (0, 0, 1), (1, 0, 0), (1 / 2, 1 / 2, 0)]
    rms = [(sum(s[k] ** 2 for s in shares) / 5) ** 0.5 for k in range(3)]
    expected = [0.9 * r / sum(rms) + 0.1 / 3 for r in rms]
    assert weighed(views) == lights.in_even_parts(np.array(expected))
    monkeypatch.setattr(lights, "in_even_parts", tuple)
    assert weighed(views) == pytest.approx(expected)


def test_lights_that_cannot_be_told_apart_are_not_weighed(weighed: Any) -> None:
    view = [[1.0, 2.0], [3.0, 1.0]]
    assert len(weighed([view])) == 2
    assert weighed([view], variant="scalar_rgb") == ()
    assert weighed([view], media=["fog"]) == ()
    assert weighed([[[0.0, 0.0], [0.0, 0.0]]]) == ()  # all is dark
    assert weighed([[[1.0, 2.0]]]) == ()
    assert len(weighed([np.ones((64, 2))])) == 64
    assert weighed([np.ones((65, 2))]) == ()


@pytest.mark.usefixtures("jit")
def test_direct_light_is_intensity_times_cosine_over_squared_distance_or_shadow() -> None:
    """A floor below two lamps, seen from above and, tilted, from below; a screen hides the second lamp from x < 0."""
    mi = activate()
    t = mi.ScalarTransform4f()
    screen = t.translate([0, 0, 1]).rotate([0, 1, 0], 90).scale(0.999)
    lamps = {f"lamp_{k}": {"type": "point", "position": p, "intensity": {"type": "rgb", "value": v}}
             for k, (p, v) in enumerate((((0.1, 0.2, 3.0), [2.0, 1.0, 4.0]), ((1.5, 0.1, 1.0), 5.0)))}  # fmt: skip
    floor = {"type": "rectangle", "to_world": t.scale(3), "bsdf": {"type": "twosided", "b": {"type": "diffuse"}}}
    loaded = build_scene(
        {"type": "scene", "floor": floor, "screen": {"type": "rectangle", "to_world": screen}, **lamps}, mi
    )
    poses = np.stack([look_at((0.05, 0, 5), (0.05, 0.1, 0)), look_at((0, 0, -4), (0, 0.5, 0))])
    rig = Rig(viewmats=poses, Ks=np.repeat(intrinsics(4, 3, 30)[None], 2, 0), width=4, height=3)
    found = lights._direct_light(mi, loaded, rig, 0, 2, 0)
    assert found.shape == (2, 12)
    c2w = np.linalg.inv(poses[0])
    order = [emitter.id() for emitter in loaded.scene.emitters()]
    bright = 0.2126 * 2 + 0.7152 * 1 + 0.0722 * 4, 5.0
    for k in range(12):
        ray = c2w[:3, :3] @ np.linalg.solve(rig.Ks[0], [k % 4 + 0.5, k // 4 + 0.5, 1])
        point = c2w[:3, 3] - c2w[2, 3] / ray[2] * ray
        away = [np.array(p) - point for p in ((0.1, 0.2, 3.0), (1.5, 0.1, 1.0))]
        first, second = (b * a[2] / np.linalg.norm(a) ** 3 for a, b in zip(away, bright, strict=True))
        if point[0] < 0.02:
            second = 0.0
        one, two = order.index("lamp_0"), order.index("lamp_1")
        assert found[one, k] == pytest.approx(first, rel=1e-3)
        assert found[two, k] == pytest.approx(second, rel=1e-3)
    assert 0 < (found[two] == 0).sum() < 12
    assert not lights._direct_light(mi, loaded, rig, 1, 2, 0).any()  # the lamps are above


@pytest.mark.usefixtures("jit")
def test_views_and_seeds_pick_points_of_a_lamp_of_their_own() -> None:
    """Two cameras at one place see one floor under two equal lamps, which are so large that points of them differ."""
    mi = activate()
    t = mi.ScalarTransform4f()
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    lamp = {"type": "rectangle", "to_world": t.translate([0, 0, 3]).rotate([1, 0, 0], 180), "emitter": glow}
    loaded = build_scene(
        {"type": "scene", "floor": {"type": "rectangle", "to_world": t.scale(3)}, "lamp": lamp, "again": lamp}, mi
    )
    pose = look_at((0.05, 0, 2), (0.05, 0.1, 0))
    rig = Rig(viewmats=np.stack([pose] * 2), Ks=np.repeat(intrinsics(4, 3, 30)[None], 2, 0), width=4, height=3)
    first, again, other_view, other_seed = (
        lights._direct_light(mi, loaded, rig, i, 2, seed) for i, seed in ((0, 0), (0, 0), (1, 0), (0, 5))
    )
    assert (first > 0).all()
    np.testing.assert_array_equal(first, again)
    assert (first != other_view).mean() > 0.9
    assert (first != other_seed).mean() > 0.9
    assert (first[0] != first[1]).mean() > 0.9  # and so do two lamps
