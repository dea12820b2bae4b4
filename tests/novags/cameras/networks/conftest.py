"""Stand-ins for DUSt3R and MASt3R: the interface and conventions of the real packages, over a scene that is known; and
what a network that is right says of a scene.

Conventions, as the packages document them: pixel centres at 0, 1, ...; one focal length a view, in px of the picture
that the network sees; poses camera-to-world; predictions for a pair in the frame of its first camera.
"""

import argparse
import importlib.machinery
import sys
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

# The frame of the estimate: the scene turned, scaled and moved.
TURN, SCALE, SHIFT = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), 0.37, np.array([2.0, -0.5, 1.5])

UNIT = 1.7  # of a network that answers in the frame of the first camera, per unit of the scene

SPELLED = (
    "{name}(pos_embed='RoPE100', patch_embed_cls='ManyAR_PatchEmbed', img_size=(512, 512), head_type='dpt', "
    "output_mode='pts3d', depth_mode=('exp', -inf, inf), conf_mode=('exp', 1, inf), enc_embed_dim=1024, two_confs=True)"
)
ARGUMENTS = {
    "pos_embed": "RoPE100", "patch_embed_cls": "PatchEmbedDust3R", "img_size": (512, 512), "head_type": "dpt",
    "output_mode": "pts3d", "depth_mode": ("exp", -np.inf, np.inf), "conf_mode": ("exp", 1, np.inf),
    "enc_embed_dim": 1024, "two_confs": True, "landscape_only": False,
}  # fmt: skip


@dataclass
class Truth:
    """What the network knows: its picture's width and height, cameras [C, 4, 4] and [C, 3, 3], depths and confidence.

    Intrinsics have pixel centres at +0.5, as in this project.
    """

    width: int
    height: int
    viewmats: np.ndarray
    Ks: np.ndarray
    depths: np.ndarray
    confidence: np.ndarray
    seen: list = field(default_factory=list)  # pictures of the views
    asked: dict = field(default_factory=dict)  # settings of the alignment

    def points(self, view: int) -> np.ndarray:
        """[H, W, 3] in the camera of a view, of pixels counted from 0."""
        y, x = np.mgrid[0 : self.height, 0 : self.width].astype(float)
        (fx, _, cx), (_, fy, cy), _ = self.Ks[view]
        rays = np.stack([(x - (cx - 0.5)) / fx, (y - (cy - 0.5)) / fy, np.ones_like(x)], -1)
        return SCALE * rays * self.depths[view][..., None]

    def pose(self, view: int) -> np.ndarray:
        """Camera to world [4, 4] in the frame of the estimate."""
        turn, shift = self.viewmats[view, :3, :3], self.viewmats[view, :3, 3]
        pose = np.eye(4)
        pose[:3, :3] = TURN @ turn.T
        pose[:3, 3] = SCALE * TURN @ (-turn.T @ shift) + SHIFT
        return pose


@dataclass(frozen=True)
class Answer:
    """What a network that is right says of pictures of a scene, in the frame of the first camera and a unit of its own.

    Intrinsics [C, 3, 3] have pixel centres at +0.5; poses [C, 4, 4] are camera-to-world; z-depths are [C, H, W], points
    in the cameras and in the world [C, H, W, 3].
    """

    Ks: np.ndarray
    poses: np.ndarray
    depths: np.ndarray
    local: np.ndarray
    points: np.ndarray
    confidence: np.ndarray

    @staticmethod
    def of(scene, Ks: np.ndarray, width: int, height: int) -> "Answer":
        first = scene.rig.viewmats[0]
        poses = np.stack([first @ np.linalg.inv(viewmat) for viewmat in scene.rig.viewmats])
        poses[:, :3, 3] *= UNIT
        depths = UNIT * np.stack(
            [scene.depth(viewmat, K, width, height) for viewmat, K in zip(scene.rig.viewmats, Ks, strict=True)]
        )
        y, x = np.mgrid[0:height, 0:width] + 0.5
        rays = np.einsum("cij,hwj->chwi", np.linalg.inv(Ks), np.stack([x, y, np.ones_like(x)], -1))
        local = rays * depths[..., None]
        points = np.einsum("cij,chwj->chwi", poses[:, :3, :3], local) + poses[:, None, None, :3, 3]
        confidence = 1 + np.random.default_rng(0).random(depths.shape)
        return Answer(Ks, poses, depths, local, points, confidence)


def same_poses(told, answer: Answer) -> None:
    """Camera-to-world poses [C, 4, 4] of the scene in the frame of the first camera, its median distance for a unit."""
    told, want = told.double().numpy(), answer.poses.copy()
    distances = np.linalg.norm(want[:, :3, 3], axis=1)
    want[:, :3, 3] /= np.sort(distances)[(len(want) - 1) // 2] if len(want) > 2 else distances[1]
    np.testing.assert_allclose(told, want, atol=1e-6)


class Network(torch.nn.Module):
    """Knows with which arguments it was made, and has two numbers for weights."""

    def __init__(self, **arguments) -> None:
        super().__init__()
        self.arguments = arguments
        self.head = torch.nn.Linear(2, 1, bias=False)


class Stage:
    """Both packages over one truth, which a test sets."""

    truth: Truth

    def make_pairs(self, imgs, scene_graph="complete", prefilter=None, symmetrize=True):
        assert prefilter is None
        assert symmetrize
        self.truth.asked["scene_graph"] = scene_graph
        for i, view in enumerate(imgs):
            assert set(view) == {"img", "true_shape", "idx", "instance"}
            assert (view["idx"], view["instance"]) == (i, str(i))
            assert view["img"].shape == (1, 3, self.truth.height, self.truth.width)
            assert view["img"].dtype == torch.float32
            assert -1 <= float(view["img"].min()) < 0 < float(view["img"].max()) <= 1
            assert view["true_shape"].dtype == np.int32
            assert view["true_shape"].tolist() == [[self.truth.height, self.truth.width]]
        self.truth.seen = [view["img"][0].numpy() for view in imgs]
        count = len(imgs) if scene_graph.split("-")[0] in ("complete", "swin") else 0  # of others no pairs
        return [(imgs[i], imgs[j]) for i in range(count) for j in range(count) if i != j]

    def check_network(self, model, device):
        assert not model.training
        torch.testing.assert_close(model.head.weight.detach().cpu(), torch.tensor([[1.0, 2.0]]))
        given = {k: tuple(v) if isinstance(v, list) else v for k, v in model.arguments.items()}
        assert given == ARGUMENTS  # of a file of JSON they are lists, which the classes take as well
        assert str(device) == "cpu"

    def inference(self, pairs, model, device, batch_size=8, verbose=True):
        self.check_network(model, device)
        first = [pair[0]["idx"] for pair in pairs]
        return {
            "view1": {"idx": first},
            "view2": {"idx": [pair[1]["idx"] for pair in pairs]},
            "pred1": {
                "pts3d": torch.tensor(np.stack([self.truth.points(i) for i in first])),
                "conf": torch.tensor(np.stack([self.truth.confidence[i] for i in first])),
            },
        }

    def global_aligner(self, dust3r_output, device, mode, verbose=True, **more):
        assert mode == "PointCloudOptimizer"
        assert not more
        return Cloud(self.truth, dust3r_output)

    def sparse_global_alignment(
        self, imgs, pairs_in, cache_path, model, subsample=8, desc_conf="desc_conf", device="cuda",
        dtype=torch.float32, shared_intrinsics=False, **kw,
    ):  # fmt: skip
        self.check_network(model, device)
        assert set(kw) <= {"lr1", "niter1", "lr2", "niter2", "opt_depth", "matching_conf_thr"}
        assert all(Path(name).is_file() for name in imgs)
        assert len(set(imgs)) == len(imgs) == len({pair[0]["idx"] for pair in pairs_in})
        self.truth.asked |= kw | {"shared_intrinsics": shared_intrinsics, "seed": torch.initial_seed()}
        Path(cache_path).mkdir(parents=True)
        return Sparse(self.truth, Path(cache_path))


class Cameras:
    """What both alignments answer to."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth
        self.poses = np.stack([truth.pose(i) for i in range(len(truth.viewmats))])

    def get_im_poses(self):
        return torch.nn.Parameter(torch.tensor(self.poses))  # as the real ones, which have a gradient

    def get_principal_points(self):
        return torch.tensor(self.truth.Ks[:, :2, 2] - 0.5)


class Cloud(Cameras):
    """Of DUSt3R: knows nothing until it has aligned."""

    def __init__(self, truth: Truth, output: dict) -> None:
        super().__init__(truth)
        self.aligned, self.output = self.poses, output
        self.poses = np.tile(np.eye(4), (len(self.poses), 1, 1))

    def compute_global_alignment(self, init=None, niter_PnP=10, **kw):
        assert init == "mst"
        assert set(kw) == {"niter", "schedule", "lr"}
        self.truth.asked |= kw | {"seed": torch.initial_seed()}
        self.poses = self.aligned

    def _of_view(self, what: str, view: int) -> np.ndarray:
        return self.output["pred1"][what][self.output["view1"]["idx"].index(view)].numpy()

    def get_focals(self):
        return torch.nn.Parameter(torch.tensor(self.truth.Ks[:, 0, :1]))  # [C, 1]

    def get_pts3d(self):
        return [
            torch.tensor(self._of_view("pts3d", i) @ pose[:3, :3].T + pose[:3, 3]) for i, pose in enumerate(self.poses)
        ]

    @property
    def im_conf(self):
        return [torch.tensor(self._of_view("conf", i)) for i in range(len(self.poses))]


class Sparse(Cameras):
    """Of MASt3R: dense points come from files of its cache."""

    def __init__(self, truth: Truth, cache: Path) -> None:
        super().__init__(truth)
        self.cache = cache

    def get_focals(self):
        return torch.tensor(self.truth.Ks[:, 0, 0])  # [C]

    def get_dense_pts3d(self, clean_depth=True, subsample=8):
        assert self.cache.is_dir()
        dense = [self.truth.points(i) @ pose[:3, :3].T + pose[:3, 3] for i, pose in enumerate(self.poses)]
        depths = [torch.tensor(SCALE * depth.reshape(-1)) for depth in self.truth.depths]
        confidence = [torch.tensor(values) for values in self.truth.confidence]
        return [torch.tensor(points.reshape(-1, 3)) for points in dense], depths, confidence


class Model(types.ModuleType):
    """`mast3r.model`: importing it is what makes the DUSt3R in the same clone importable."""

    def __init__(self, modules: dict[str, types.ModuleType], monkeypatch) -> None:
        super().__init__("mast3r.model")
        self.modules, self.monkeypatch = modules, monkeypatch

    def __getattr__(self, name: str):
        if name != "AsymmetricMASt3R":
            raise AttributeError(name)
        install(self.monkeypatch, self.modules)
        return type("AsymmetricMASt3R", (Network,), {})


def install(monkeypatch, modules: dict[str, types.ModuleType]) -> None:
    for name, module in modules.items():
        module.__spec__ = importlib.machinery.ModuleSpec(name, None)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def stage(monkeypatch) -> Callable[[str], Stage]:
    """Installs one of the packages."""

    def make(package: str) -> Stage:
        stage = Stage()
        dust3r = {name: types.ModuleType(name) for name in
                  ("dust3r", "dust3r.model", "dust3r.image_pairs", "dust3r.inference", "dust3r.cloud_opt")}  # fmt: skip
        dust3r["dust3r.model"].AsymmetricCroCo3DStereo = type("AsymmetricCroCo3DStereo", (Network,), {})
        dust3r["dust3r.image_pairs"].make_pairs = stage.make_pairs
        dust3r["dust3r.inference"].inference = stage.inference
        dust3r["dust3r.cloud_opt"].global_aligner = stage.global_aligner
        dust3r["dust3r.cloud_opt"].GlobalAlignerMode = types.SimpleNamespace(PointCloudOptimizer="PointCloudOptimizer")
        if package == "dust3r":
            install(monkeypatch, dust3r)
            return stage
        mast3r = {name: types.ModuleType(name) for name in ("mast3r", "mast3r.cloud_opt", "mast3r.cloud_opt.sparse_ga")}
        mast3r["mast3r.cloud_opt.sparse_ga"].sparse_global_alignment = stage.sparse_global_alignment
        install(monkeypatch, mast3r | {"mast3r.model": Model(dust3r, monkeypatch)})
        return stage

    return make


@pytest.fixture
def weights(tmp_path) -> Callable[..., Path]:
    """Writes a .pth as published: training state around the weights, and the arguments as the text of a call."""

    def make(name: str, **wrong) -> Path:
        held = {
            "args": argparse.Namespace(model=SPELLED.format(name=name), lr=1e-4), "epoch": 3,
            "model": {"head.weight": torch.tensor([[1.0, 2.0]]), "mask_token": torch.zeros(1)},
        }  # fmt: skip
        torch.save(held | wrong, tmp_path / "weights.pth")
        return tmp_path / "weights.pth"

    return make


@pytest.fixture
def arguments() -> dict:
    """Those of the class when it is made for inference."""
    return dict(ARGUMENTS)


@pytest.fixture
def truth() -> type[Truth]:
    return Truth


@pytest.fixture
def answered() -> Callable[..., Answer]:
    return Answer.of


@pytest.fixture
def told_as() -> Callable[..., None]:
    return same_poses


@pytest.fixture
def installed(monkeypatch) -> Callable[..., None]:
    """Makes modules of a package: `installed({"package.part": {"name": value}})`."""

    def make(parts: dict[str, dict]) -> None:
        modules: dict[str, types.ModuleType] = {}
        for path, names in parts.items():
            words = path.split(".")
            for k in range(1, len(words) + 1):
                modules.setdefault(".".join(words[:k]), types.ModuleType(".".join(words[:k])))
            modules[path].__dict__.update(names)
        install(monkeypatch, modules)

    return make
