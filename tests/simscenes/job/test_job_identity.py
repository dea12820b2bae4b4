"""A file on disk is taken for what was asked only if everything its pixels depend on is the same."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, orbit_rig
from simscenes.job.finish import SCRATCH, view_store
from simscenes.job.identity import (
    finished_view,
    is_complete,
    job_digest,
    plan_identity,
    seconds_spent,
    view_key,
    without_nan,
)
from simscenes.sets.pictures.exr import write_exr
from simscenes.transport.planner import default_plan

RIG = orbit_rig(4, 8, 6, 40, radius=3.0)


def config(motion: float | None = None, **more: Any) -> dict[str, Any]:
    return {"seed": 0, "optics": {"motion": motion, "camera": None}, **more}


def other(rig: Rig = RIG, *, order: tuple[int, ...] = (0, 1, 2, 3), focal: float = 1.0, **size: int) -> Rig:
    """The rig with its views in another order, another focal length of its last view, another size."""
    Ks = rig.Ks[list(order)].copy()
    Ks[-1, :2, :2] *= focal
    return replace(rig, viewmats=rig.viewmats[list(order)], Ks=Ks, **size)


def test_a_digest_tells_cameras_sizes_and_settings_apart() -> None:
    rigs = [RIG, other(order=(1, 0, 2, 3)), other(focal=1.01), other(width=6, height=8), other(width=9)]
    rigs += [other(order=(0, 1, 2)), other(height=9)]
    digests = [job_digest(config(), rig) for rig in rigs] + [job_digest(config(seed=1), RIG)]
    assert len(set(digests)) == len(digests)
    assert all(len(bytes.fromhex(digest)) == 32 for digest in digests)
    shuffled = dict(reversed(config().items()))
    assert job_digest(shuffled, other()) == digests[0]


def test_the_key_of_a_view_at_rest_is_that_of_its_camera_alone() -> None:
    keys = [view_key(config(), RIG, i) for i in range(4)]
    assert len(set(keys)) == 4
    assert [view_key(config(), other(order=(2, 0, 3)), k) for k in range(3)] == [keys[2], keys[0], keys[3]]
    changed = [view_key(config(), other(focal=1.01), i) for i in range(4)]
    assert [a == b for a, b in zip(keys, changed, strict=True)] == [True, True, True, False]
    assert view_key(config(seed=1), RIG, 0) != keys[0]
    assert view_key(config(), other(width=9), 0) != keys[0]


def test_the_key_of_a_view_in_motion_is_that_of_its_place_among_all_cameras() -> None:
    keys = [view_key(config(0.3), RIG, i) for i in range(4)]
    assert len(set(keys)) == 4
    assert [view_key(config(0.3), other(), i) for i in range(4)] == keys
    for rig in (other(focal=1.01), other(order=(0, 1, 3, 2)), other(order=(0, 1, 2))):
        assert view_key(config(0.3), rig, 0) != keys[0]  # whose neighbours are others


def test_numbers_that_were_not_measured_become_null() -> None:
    told = {"a": math.nan, "b": [1.5, -math.inf, {"c": (math.inf, 2)}], "d": "nan", "e": None, "f": 0.0, "g": True}
    assert without_nan(told) == {"a": None, "b": [1.5, None, {"c": [None, 2]}], "d": "nan", "e": None, "f": 0.0, "g": 1}


def test_a_plan_is_known_by_what_the_pixels_depend_on() -> None:
    made = default_plan(Optics())
    found = plan_identity(made)
    assert found == json.loads(json.dumps(found, allow_nan=False))
    assert "seconds" not in found
    assert found["max_depth"] == 64
    assert plan_identity(replace(made, seconds={"planned": 2.0})) == found
    assert plan_identity(replace(made, max_depth=8)) != found
    assert plan_identity("rgb") == "rgb"


def test_a_set_is_complete_with_all_its_files_and_its_own_digest(tmp_path: Path) -> None:
    names = ["0000", "0001"]
    files = [tmp_path / folder / f"{n}.{end}" for folder, end in (("gt", "exr"), ("images", "png")) for n in names]
    assert not is_complete(tmp_path, "abc", names)
    for file in files:
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(b"")
    assert not is_complete(tmp_path, "abc", names)
    (tmp_path / "set.json").write_text('{"digest": "abc"}')
    assert is_complete(tmp_path, "abc", names)
    assert not is_complete(tmp_path, "abd", names)
    assert not is_complete(tmp_path, "abc", [*names, "0002"])
    for file in files:
        file.rename(tmp_path / "away")
        assert not is_complete(tmp_path, "abc", names)
        (tmp_path / "away").rename(file)
    for damaged in ('{"digest": "ab', '["abc"]', "{}"):
        (tmp_path / "set.json").write_text(damaged)
        assert not is_complete(tmp_path, "abc", names)


def test_seconds_count_for_the_job_that_spent_them(tmp_path: Path) -> None:
    assert seconds_spent(tmp_path, "abc") == {}
    file = tmp_path / "seconds.json"
    file.write_text('{"digest": "abc", "seconds": {"plan": 2.5, "write": 1}}')
    assert seconds_spent(tmp_path, "abc") == {"plan": 2.5, "write": 1}
    assert seconds_spent(tmp_path, "abd") == {}
    for damaged in ('{"digest": "abc", "sec', '{"digest": "abc"}', "3", '{"digest": "abc", "seconds": 3}'):
        file.write_text(damaged)
        assert seconds_spent(tmp_path, "abc") == {}


def test_a_view_is_taken_over_with_its_own_key_only(tmp_path: Path) -> None:
    path, light = tmp_path / "view.exr", np.arange(6, dtype=np.float32).reshape(2, 3)
    assert finished_view(path, "key {}".format) is None
    write_exr(path, {"R": light}, {"novagsKey": "key 0", "spp": 16})
    found = finished_view(path, "key {}".format)
    assert found is not None
    assert np.array_equal(found[0]["R"], light)
    assert found[1]["spp"] == 16
    assert finished_view(path, "other {}".format) is None
    write_exr(path, {"R": light}, {"novagsKey": "key 40", "leastSpp": 40})  # its siblings asked for more samples
    assert finished_view(path, "key {}".format) is not None
    write_exr(path, {"R": light}, {"novagsKey": "key 40", "leastSpp": 41})
    assert finished_view(path, "key {}".format) is None
    path.write_bytes(path.read_bytes()[:100])
    assert finished_view(path, "key {}".format) is None


def test_what_is_kept_of_the_views_is_gone_afterwards_whatever_happens(tmp_path: Path) -> None:
    folder = tmp_path / "set" / SCRATCH
    folder.mkdir(parents=True)
    (folder / "0.light.npy").write_bytes(b"of a process that was killed")

    def interrupted(remove: bool) -> None:
        with view_store(tmp_path / "set", RIG, None):
            assert not list(folder.iterdir())
            if remove:
                folder.rmdir()
            raise KeyboardInterrupt

    for remove in (False, True):  # a folder that somebody else removed meanwhile hides no other error
        with pytest.raises(KeyboardInterrupt):
            interrupted(remove)
        assert not folder.exists()


def test_a_store_gives_back_light_and_depth_and_one_exposure(tmp_path: Path) -> None:
    """White is what 97 % of all pixels of all views stay below, by the brightest channel."""
    rng = np.random.default_rng(0)
    views = [rng.lognormal(0, 1, (4, 6, 8)).astype(np.float32) for _ in range(4)]
    with view_store(tmp_path, RIG, None) as store:
        for i in (2, 0, 3, 1):
            store.put(i, dict(zip("RGBZ", views[i], strict=True)))
        for i in range(4):
            assert np.array_equal(store.light(i), np.moveaxis(views[i][:3], 0, -1))
            assert np.array_equal(store.depth(i), views[i][3])
        brightest = sorted(max(pixel) for view in views for pixel in view[:3].reshape(3, -1).T.tolist())
        place = 0.97 * (4 * 48 - 1)
        low, high = brightest[int(place)], brightest[int(place) + 1]
        assert store.exposure_scale() == pytest.approx(1 / (low + (place - int(place)) * (high - low)))
