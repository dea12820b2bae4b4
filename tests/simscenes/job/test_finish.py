"""A set is finished view by view, and comes out as if all views had been at hand at once."""

import gc
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sensor_model import linear_to_srgb
from simscenes import MultiviewSet, Optics, Rig, orbit_rig, read_exr, render_set
from simscenes.backend import activate
from simscenes.camera import camera_color
from simscenes.job import finish, identity, views
from simscenes.job.exposure import RunningQuantile
from simscenes.rigs import unproject
from simscenes.sets.geometry.correspondence import seen_in

SEED = 5
RIG = orbit_rig(3, 23, 17, 60, target=(0, 0, 0.5), radius=3.0)


def lamp_and_ball() -> dict[str, Any]:
    """A bright lamp in view of some cameras, a coloured ball and a floor that ends: some rays meet nothing."""
    t = activate().ScalarTransform4f()
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.3, 0.1]}}
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 30.0}}
    return {
        "type": "scene",
        "floor": {"type": "rectangle", "to_world": t.scale(1.5), "bsdf": paint},
        "ball": {"type": "sphere", "center": [0, 0, 0.5], "radius": 0.5, "bsdf": paint},
        "lamp": {"type": "sphere", "center": [0.5, 0.9, 0.9], "radius": 0.15, "emitter": glow},
    }


def rendered(out: Path, **settings: Any) -> MultiviewSet:
    return render_set(lamp_and_ball(), RIG, out, **{"spp": 4, "plan": "rgb", "seed": SEED} | settings)


def quantile_of(values: np.ndarray, q: float) -> float:
    """numpy's. Before 2.3 it rounds the place between two values to float32, unless there are two alone."""
    if np.lib.NumpyVersion(np.__version__) >= "2.3.0":
        return float(np.quantile(values, q))
    place = q * (len(values) - 1)
    two = np.sort(values)[int(place) : int(place) + 2]
    return float(np.quantile(two, place - int(place)))


def finished_at_once(out: Path, rig: Rig, camera: str | None) -> dict[str, Any]:
    """The slow way: every view in memory, read back from its file."""
    channels = [read_exr(path)[0] for path in sorted((out / "gt").glob("*.exr"))]
    light = [np.stack([view[c] for c in "RGB"], -1) for view in channels]
    if camera is not None:
        light = [view @ np.linalg.inv(camera_color(camera).matrix).T.astype(np.float32) for view in light]
    scale = 1 / quantile_of(np.concatenate([view.max(-1).ravel() for view in light]), 0.97)
    images = [np.rint(255 * linear_to_srgb(np.clip(view * np.float32(scale), 0, 1))).astype(np.uint8) for view in light]
    rng, places, colors = np.random.default_rng([SEED, 3]), [], []
    for i, view in enumerate(channels):
        chosen = rng.permutation(np.flatnonzero(np.isfinite(view["Z"]).ravel()))[: int(np.ceil(1.3 * 4000 / len(rig)))]
        places.append(unproject(rig, i, view["Z"], chosen))
        colors.append(images[i].reshape(-1, 3)[chosen])
    xyz, rgb = np.concatenate(places), np.concatenate(colors)
    pixels, distance = rig.project(xyz)
    visible = np.stack([seen_in(rig, pixels[i], distance[i], view["Z"]) for i, view in enumerate(channels)])
    kept = np.sort(rng.permutation(np.flatnonzero(visible.sum(0) >= 2))[:4000])
    return {"scale": scale, "images": images, "points": (xyz[kept], rgb[kept], visible[:, kept])}


class Watched:
    """Arrays that a function gave out, to be gone when it is called again."""

    def __init__(self) -> None:
        self.given: list[weakref.ref[Any]] = []
        self.calls: list[Any] = []
        self.most = 0

    def __call__(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*arguments: Any) -> Any:
            gc.collect()
            self.most = max(self.most, len({call for call, ref in self.given if ref() is not None}) + 1)
            found = function(*arguments)
            self.calls.append(arguments)
            arrays = found[0] if isinstance(found, tuple) else found
            arrays = arrays.values() if isinstance(arrays, dict) else [arrays]
            self.given += [(len(self.calls), weakref.ref(a)) for a in arrays]
            return found

        return watched


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Watched]]:
    """Whatever brings a view's channels into memory: rendering, reading EXR files, the store."""
    gc.collect()
    gc.freeze()  # or each look for arrays that are gone would go through all objects of the libraries
    seen = {"render": Watched(), "read": Watched(), "light": Watched(), "depth": Watched()}
    monkeypatch.setattr(views, "geometry_channels", seen["render"](views.geometry_channels))
    monkeypatch.setattr(identity, "read_exr", seen["read"](identity.read_exr))
    for name in ("light", "depth"):
        monkeypatch.setattr(finish.ViewStore, name, seen[name](getattr(finish.ViewStore, name)))
    yield seen
    gc.unfreeze()


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The sparse points as they are written."""
    written: list[Any] = []
    original = finish.surface_points

    def kept(*arguments: Any, **settings: Any) -> Any:
        written.append(original(*arguments, **settings))
        return written[-1]

    monkeypatch.setattr(finish, "surface_points", kept)
    return written


def check_outcome(done: MultiviewSet, points: Any, camera: str | None = None) -> None:
    expected = finished_at_once(done.path, RIG, camera)
    assert done.meta["exposure_scale"] == expected["scale"]
    for file, image in zip(done.files, expected["images"], strict=True):
        assert np.array_equal(cv2.imread(str(file))[..., ::-1], image)
    assert len(points[0]) > 50
    for found, wanted in zip(points, expected["points"], strict=True):
        assert np.array_equal(found, wanted)


@pytest.mark.parametrize("camera", [None, "Nikon 5100 (NPL)"])
def test_the_outcome_is_that_of_all_views_at_once(camera: str | None, points: list[Any], tmp_path: Path) -> None:
    done = rendered(tmp_path, optics=Optics(camera=camera))
    check_outcome(done, points[0], camera)
    assert not (tmp_path / finish.SCRATCH).exists()


def test_one_view_is_held_at_a_time_and_none_is_read_that_was_just_rendered(
    watched: dict[str, Watched], tmp_path: Path
) -> None:
    rendered(tmp_path)
    assert {name: w.most for name, w in watched.items()} == {"render": 1, "read": 0, "light": 1, "depth": 1}
    assert len(watched["render"].calls) == len(RIG)


def test_of_an_interrupted_job_finished_views_are_read_once_and_the_outcome_is_the_same(
    watched: dict[str, Watched], points: list[Any], tmp_path: Path
) -> None:
    whole = rendered(tmp_path)
    images = [file.read_bytes() for file in whole.files]
    (tmp_path / "set.json").unlink()
    (tmp_path / "gt" / "0001.exr").unlink()
    (tmp_path / finish.SCRATCH).mkdir()
    (tmp_path / finish.SCRATCH / "0.light.npy").write_bytes(b"of a process that was killed")
    again = rendered(tmp_path)
    assert [path.name for (path,) in watched["read"].calls] == ["0000.exr", "0002.exr"]
    assert watched["read"].most == 1
    assert len(watched["render"].calls) == len(RIG) + 1
    assert [file.read_bytes() for file in again.files] == images
    check_outcome(again, points[1])


@pytest.mark.parametrize("count", [1, 2, 3, 33, 34, 35, 101, 1000, 4097])
@pytest.mark.parametrize("q", [0.0, 0.5, 0.97, 1.0])
def test_a_running_quantile_is_numpys_to_the_last_bit(count: int, q: float) -> None:
    values = np.random.default_rng(count).lognormal(0, 2, count).astype(np.float32)
    values[::7] = values[0]  # equal ones
    running = RunningQuantile(q, count)
    for part in np.array_split(values, min(7, count)):
        running.add(part)
    assert running.value() == quantile_of(values, q)
    assert running.value() == pytest.approx(float(np.quantile(values.astype(np.float64), q)), rel=2e-7)


def test_a_running_quantile_keeps_only_what_lies_above() -> None:
    running = RunningQuantile(0.97, 10_000)
    for part in np.random.default_rng(0).random((100, 10, 10), dtype=np.float32):
        running.add(part)
    assert running._kept is not None
    assert running._kept.base is None
    assert len(running._kept) == 301


def test_a_black_set_has_an_exposure_of_one(tmp_path: Path) -> None:
    dark = {"type": "scene", "ball": {"type": "sphere"}, "lamp": {"type": "point", "intensity": 0.0}}
    done = render_set(dark, RIG, tmp_path, spp=2, plan="rgb")
    assert done.meta["exposure_scale"] == 1.0
    assert not done.image(0).any()
