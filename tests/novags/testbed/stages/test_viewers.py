"""Files of a run for the viewers of others."""

import gzip
import json
import struct

import numpy as np
import pytest
import torch

from novags.splats import Gaussians, Views, read_ply, write_ply
from novags.testbed.stages.camera_source import viewer_cameras
from novags.testbed.stages.viewers import viewer_files, write_viewers
from simscenes import orbit_rig


def test_cameras_are_listed_as_the_web_viewer_turns_them_into_views():
    rig = orbit_rig(3, 40, 30, 50.0, target=(0.1, 0.2, 0.3), radius=2.0)
    views = [
        Views(torch.tensor(rig.viewmats[i : i + 1]).float(), torch.tensor(rig.Ks[i : i + 1]).float(), 40, 30)
        for i in range(3)
    ]
    listed = json.loads(json.dumps(viewer_cameras(["a", "b", "c"], views)))
    assert [(c["id"], c["img_name"], c["width"], c["height"]) for c in listed] == [
        (0, "a", 40, 30), (1, "b", 40, 30), (2, "c", 40, 30),
    ]  # fmt: skip
    for camera, viewmat, K in zip(listed, rig.viewmats, rig.Ks, strict=True):
        R, t = np.array(camera["rotation"]), np.array(camera["position"])
        view = np.eye(4)  # antimatter15's getViewMatrix, its columns as ours
        view[:3, :3], view[:3, 3] = R.T, -R.T @ t
        np.testing.assert_allclose(view, viewmat, atol=1e-6)
        assert (camera["fx"], camera["fy"]) == pytest.approx((K[0, 0], K[1, 1]))


def test_formats_are_written_beside_the_run_on_request(tmp_path):
    g = Gaussians.from_points(torch.rand(6, 3), torch.rand(6, 3), sh_degree=1)
    with pytest.raises(ValueError, match=r"has no point_cloud\.ply: only Gaussians can be exported as splat"):
        write_viewers(tmp_path, ("splat",))
    write_ply(tmp_path / "point_cloud.ply", g)
    (tmp_path / "cameras.json").write_text('[{"id": 0}]')
    (tmp_path / "run.json").write_text('{"antialiased": true}')
    write_viewers(tmp_path, ())
    assert not (tmp_path / "viewers").exists()
    write_viewers(tmp_path, ("3dgs", "splat", "spz", "spz2"))
    out = tmp_path / "viewers"
    assert sorted(p.name for p in out.iterdir()) == [
        "cameras.json", "point_cloud.ply", "scene-v2.spz", "scene.splat", "scene.spz",
    ]  # fmt: skip
    assert read_ply(out / "point_cloud.ply").sh_degree == 3
    for name, version in (("scene.spz", 3), ("scene-v2.spz", 2)):
        assert struct.unpack("<II", gzip.decompress((out / name).read_bytes())[:8])[1] == version
    assert json.loads((out / "cameras.json").read_text()) == [{"id": 0}]
    with pytest.raises(ValueError, match="export must be among 3dgs, splat, spz, spz2; got obj"):
        write_viewers(tmp_path, ("obj",))
    assert viewer_files(tmp_path, ("splat", "3dgs")) == [
        out / "scene.splat", out / "point_cloud.ply", out / "cameras.json"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("facts", "light"),
    [
        ({"space": "linear"}, True),
        ({"space": "linear", "tone": {"top": 1.0, "k": 0.1}}, False),
        ({"space": "enhanced"}, False),
        ({"space": "enhanced", "response": {"values": [0.0, 1.0]}}, True),
    ],
)
def test_gaussians_that_hold_light_are_said_to_look_darker_elsewhere(tmp_path, facts, light):
    write_ply(tmp_path / "point_cloud.ply", Gaussians.from_points(torch.rand(6, 3), torch.rand(6, 3), sh_degree=0))
    (tmp_path / "run.json").write_text(json.dumps(facts))
    said = write_viewers(tmp_path, ("splat",))
    assert ("hold light, which viewers of others take for sRGB code" in said) == light
    assert bool(said) == light
