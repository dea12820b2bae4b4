"""The adapter to VGGSfM against a stand-in of its program, which knows the scene and writes a model like its own."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from novags.cameras.align import align
from novags.cameras.networks import vggsfm
from novags.cameras.networks.vggsfm import vggsfm_cameras
from novags.cameras.sources.vggsfm import VggsfmConfig

# In the frame of the estimate, turned, scaled and moved; cameras of the size of the pictures; a file for each part of
# the model as pycolmap 3.10 writes it, which knows no rigs and no frames.
DEMO = """
import json, sys, zipfile
from pathlib import Path
import numpy as np, pycolmap
from scipy.spatial.transform import Rotation

given = dict(word.split("=", 1) for word in sys.argv[1:])
scene, home = Path(given["SCENE_DIR"]), Path(".")
truth = np.load(home / "truth.npz")
assert sorted(path.name for path in scene.iterdir()) == ["images", "weights.bin"]
assert zipfile.is_zipfile(given["resume_ckpt"])  # as torch.save writes them
(home / "given.json").write_text(json.dumps(given))
if truth["fails"]:
    print("some progress")
    raise SystemExit("RuntimeError: CUDA out of memory")
model = pycolmap.Reconstruction()
turn, scale, shift = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), 0.37, np.array([2.0, -0.5, 1.5])
points = scale * truth["points"] @ turn.T + shift
names = sorted(path.name for path in (scene / "images").iterdir())
tracks = [pycolmap.Track() for _ in points]
for i, name in reversed(list(enumerate(names))):  # in no particular order
    if i in truth["lost"]:
        continue
    width, height = truth["size"]
    f, (cx, cy) = truth["Ks"][i, 0, 0], truth["Ks"][i, :2, 2]
    params = [f, cx, cy] if truth["model"] == "SIMPLE_PINHOLE" else [f, cx, cy, 0.1]
    camera = pycolmap.Camera(model=str(truth["model"]), width=int(width), height=int(height), params=params)
    camera.camera_id = i + 1
    model.add_camera_with_trivial_rig(camera)
    rotation = truth["viewmats"][i, :3, :3] @ turn.T
    moved = scale * truth["viewmats"][i, :3, 3] - rotation @ shift
    pose = pycolmap.Rigid3d(np.concatenate([rotation, moved[:, None]], 1))
    seen = np.flatnonzero(truth["seen"][i])
    # Keypoints are those of the picture of 1024 px that it works on, as its documentation says.
    pixels = [pycolmap.Point2D(xy=1024 / width * np.ones(2)) for _ in seen]
    image = pycolmap.Image(name=name, camera_id=i + 1, image_id=i + 1, points2D=pycolmap.Point2DList(pixels))
    model.add_image_with_trivial_frame(image, pose)
    for row, point in enumerate(seen):
        tracks[point].add_element(i + 1, row)
for point, track in zip(points, tracks):
    model.add_point3D(point, track)
if len(model.images):
    (scene / "sparse").mkdir()
    model.write(scene / "sparse")
    for name in ("rigs.bin", "frames.bin"):
        (scene / "sparse" / name).unlink()
"""


@pytest.fixture
def shown(corner, tmp_path):
    """A corner of a room, and the configuration that runs the stand-in on it."""

    def make(count: int = 4, *, lost=(), fails: bool = False, model: str = "SIMPLE_PINHOLE", n: int = 200):
        scene = corner(count, 64, 48)
        rng = np.random.default_rng(0)
        points = rng.uniform(0, 0.6, (n, 3))
        axis = rng.integers(0, 3, n)  # each on one of the planes of the corner
        points[np.arange(n), axis] = np.array([0.7, 0.7, 0.0])[axis]
        seen = []
        for viewmat, K in zip(scene.rig.viewmats, scene.rig.Ks, strict=True):
            camera = points @ viewmat[:3, :3].T + viewmat[:3, 3]
            pixels = (camera @ K.T)[:, :2] / camera[:, 2:]
            seen.append(((pixels > 0) & (pixels < [64, 48])).all(1))
        home, weights = tmp_path / "clone", tmp_path / "v=2, of 2024.bin"
        home.mkdir(exist_ok=True)
        (home / "demo.py").write_text(DEMO)
        np.savez(
            home / "truth.npz", points=points, seen=np.stack(seen), lost=np.array(lost, int), fails=fails, model=model,
            size=[64, 48], Ks=scene.rig.Ks, viewmats=scene.rig.viewmats,
        )  # fmt: skip
        torch.save({"camera.weight": torch.zeros(2)}, weights)
        return scene, VggsfmConfig(checkpoint=weights, home=home, python=sys.executable)

    return make


def as_dark(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures.astype(np.float32) / 2550)


def test_aligned_cameras_are_the_true_ones_and_unplaced_views_are_left_out(shown):
    scene, config = shown(lost=[2])
    found = vggsfm_cameras(scene.pictures, as_dark(scene.pictures), n_points=100, config=config, seed=5)
    assert found.registered == (0, 1, 3)
    aligned = align(found.viewmats, torch.tensor(scene.rig.viewmats)[[0, 1, 3]])
    # A file of COLMAP holds float64; the points are float32 then.
    assert aligned.rotation_deg.max() < 1e-5
    assert aligned.centre_error.max() < 1e-6
    np.testing.assert_allclose(found.Ks.numpy(), scene.rig.Ks[[0, 1, 3]], rtol=1e-12)
    assert len(found.points) == 100
    assert found.made_of == {"of the sparse model": 100}
    assert scene.distance(aligned.similarity.apply(found.points.double()).numpy()).max() < 1e-5
    given = json.loads((config.home / "given.json").read_text())
    assert {k: v for k, v in given.items() if k not in ("SCENE_DIR", "resume_ckpt")} == {
        "auto_download_ckpt": "False", "camera_type": "SIMPLE_PINHOLE", "shared_camera": "False",
        "query_frame_num": "3", "max_query_pts": "2048", "seed": "5",
    }  # fmt: skip
    assert not Path(given["SCENE_DIR"]).exists()


def test_the_seed_of_the_program_chooses_the_points_too(shown, monkeypatch):
    scene, config = shown()
    seeds = []
    monkeypatch.setattr(vggsfm, "_run", lambda config, root, seed, device: seeds.append(seed))
    monkeypatch.setattr(vggsfm, "_model", lambda *_: None)
    monkeypatch.setattr(vggsfm, "from_reconstruction", lambda model, dark, count, seed, **_: seeds.append(seed))
    vggsfm_cameras(scene.pictures, as_dark(scene.pictures), n_points=100, config=config, seed=5)
    assert seeds == [5, 5]


def test_where_the_model_has_fewer_points_they_are_filled_up_between_those_a_view_observes(shown):
    scene, config = shown()
    found = vggsfm_cameras(scene.pictures, as_dark(scene.pictures), n_points=700, config=config)
    assert found.made_of == {"of the sparse model": 200, "between its points": 500}
    similarity = align(found.viewmats, torch.tensor(scene.rig.viewmats)).similarity
    off = scene.distance(similarity.apply(found.points.double()).numpy())
    # Interpolated inverse depth is exact on a plane and off at the edges of the corner; cameras are 1.6 away.
    assert np.sort(off)[199] < 1e-5
    assert np.median(off) < 0.03


def test_a_program_that_fails_says_its_last_line(shown):
    scene, config = shown(fails=True)
    with pytest.raises(ValueError, match=r"VGGSfM ended with exit code 1: RuntimeError: CUDA out of memory; try"):
        vggsfm_cameras(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)


def test_too_few_views_no_model_and_lenses_that_bend_are_refused(shown):
    scene, config = shown(lost=[0, 1, 3])
    dark = as_dark(scene.pictures)
    with pytest.raises(ValueError, match=r"VGGSfM registered 1 of 4 views of the raw pictures.*pictures=enhanced"):
        vggsfm_cameras(scene.pictures, dark, n_points=10, config=config)
    shown(lost=[0, 1, 2, 3])
    with pytest.raises(
        ValueError, match="its sparse folder holds no COLMAP model .*use the version of its main branch"
    ):
        vggsfm_cameras(scene.pictures, dark, n_points=10, config=config)
    shown(model="SIMPLE_RADIAL")
    with pytest.raises(ValueError, match="lenses must be pinholes, got SIMPLE_RADIAL"):
        vggsfm_cameras(scene.pictures, dark, n_points=10, config=config)


class Bomb:
    """A pickle that makes a file when it is read."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self):
        return (Path.touch, (self.file,))


def test_weights_that_would_run_code_never_reach_the_program(shown, tmp_path):
    scene, config = shown()
    torch.save({"camera.weight": Bomb(tmp_path / "mark")}, config.checkpoint)
    with pytest.raises(ValueError, match="cannot be read as weights without running code"):
        vggsfm_cameras(scene.pictures, as_dark(scene.pictures), n_points=10, config=config)
    assert not (tmp_path / "mark").exists()
    assert not (config.home / "given.json").exists()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"home": Path("nowhere")},
            r"nowhere has no demo.py: clone https://github.com/facebookresearch/vggsfm.*CC BY-NC",
        ),
        ({"checkpoint": Path("none.bin")}, "no VGGSFM weights at none.bin: download .*vggsfm:checkpoint=FILE"),
        ({"python": "no-such-python"}, "no-such-python cannot be run: .*vggsfm:python=FILE"),
        ({"python": "bin/python"}, "bin/python cannot be run: give the absolute path"),
    ],
)
def test_what_is_missing_is_said_with_what_to_do(shown, wrong, message, monkeypatch, tmp_path):
    scene, config = shown()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").symlink_to(sys.executable)
    monkeypatch.chdir(tmp_path)
    given = {"checkpoint": config.checkpoint, "home": config.home, "python": config.python} | wrong
    with pytest.raises(ValueError, match=message):
        vggsfm_cameras(scene.pictures, as_dark(scene.pictures), n_points=10, config=VggsfmConfig(**given))


def test_impossible_settings_are_refused(shown):
    _, config = shown()
    for wrong in ({"query_frames": 0}, {"query_points": 7}):
        with pytest.raises(ValueError, match="vggsfm needs query_frames >= 1 and query_points >= 8"):
            VggsfmConfig(checkpoint=config.checkpoint, home=config.home, **wrong)
    with pytest.raises(ValueError, match="pictures of vggsfm must be one of raw"):
        VggsfmConfig(checkpoint=config.checkpoint, home=config.home, pictures="lit")
