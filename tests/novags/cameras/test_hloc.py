"""The adapter to hloc against a stand-in whose features are true points of the scene, seen from true cameras.

Conventions of hloc: the centre of the first pixel is at 0; a match is an index into the keypoints of the other picture,
and -1 means that a keypoint has no match. hloc writes HDF5; the stand-in writes numpy files behind the same functions.
"""

import importlib.machinery
import importlib.util
import sys
import types
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch

from novags.cameras.align import align
from novags.cameras.motion.hloc import hloc_cameras
from novags.cameras.sources.hloc import HlocConfig

WIDTH, HEIGHT = 128, 112


class Hloc:
    """The functions of hloc that are called."""

    features = {
        "disk": {"output": "feats-disk", "model": {"name": "disk"}},
        "sift": {"output": "feats-sift", "model": {"name": "dog"}},
    }
    matchers = {
        "disk+lightglue": {"output": "matches-disk-lightglue", "model": {"name": "lightglue"}},
        "NN-ratio": {"output": "matches-NN-ratio", "model": {"name": "nearest_neighbor"}},
        "superglue": {"output": "matches-superglue", "model": {"name": "superglue"}},
    }

    def __init__(self, keypoints: list[np.ndarray], ids: list[np.ndarray]) -> None:
        self.keypoints, self.ids = keypoints, ids  # [n_i, 2] and which points of the scene these are [n_i]
        self.used: list[str] = []
        self.draws: list[float] = []

    def extract(
        self, conf, image_dir, export_dir=None, as_half=True, image_list=None, feature_path=None, overwrite=False
    ):
        assert not as_half
        assert all((image_dir / name).is_file() for name in image_list)
        self.used.append(conf["output"])
        self.draws.append(float(torch.rand(1)))
        self._save(feature_path, dict(zip(image_list, self.keypoints, strict=True)))
        self.names = list(image_list)
        return feature_path

    def exhaustive(self, output, image_list=None, features=None):
        pairs = [(a, b) for i, a in enumerate(image_list) for b in image_list[i + 1 :]]
        output.write_text("\n".join(" ".join(pair) for pair in pairs))

    def match(self, conf, pairs, features, export_dir=None, matches=None, features_ref=None, overwrite=False):
        assert isinstance(features, Path)
        self.used.append(conf["output"])
        rng, found = np.random.default_rng(0), {}
        for line in pairs.read_text().splitlines():
            first, second = line.split()
            a, b = (self.ids[self.names.index(name)] for name in (first, second))
            place = {point: row for row, point in enumerate(b)}
            rows = np.array([place.get(point, -1) for point in a], np.int16)
            wrong = (rng.random(len(rows)) < 0.1) & (len(b) > 0)  # outliers, as every matcher has them
            rows[wrong] = rng.integers(0, max(len(b), 1), int(wrong.sum()))
            found[f"{first}/{second}"] = rows
        self._save(matches, found)
        return matches

    @staticmethod
    def _save(file: Path, arrays: dict) -> None:
        with file.open("wb") as out:
            np.savez(out, **{name.replace("/", "|"): value for name, value in arrays.items()})

    @staticmethod
    def get_keypoints(path, name, return_uncertainty=False):
        return np.load(path)[name]

    @staticmethod
    def get_matches(path, name0, name1):
        rows = np.load(path)[f"{name0}|{name1}"]
        kept = np.where(rows != -1)[0]
        return np.stack([kept, rows[kept]], -1), np.ones(len(kept))


@pytest.fixture
def installed(monkeypatch):
    """Makes the stand-in importable as hloc."""

    def make(stand_in: Hloc) -> Hloc:
        modules = {name: types.ModuleType(name) for name in (
            "hloc", "hloc.extract_features", "hloc.match_features", "hloc.pairs_from_exhaustive", "hloc.utils",
            "hloc.utils.io",
        )}  # fmt: skip
        modules["hloc.extract_features"].confs, modules["hloc.extract_features"].main = Hloc.features, stand_in.extract
        modules["hloc.match_features"].confs, modules["hloc.match_features"].main = Hloc.matchers, stand_in.match
        modules["hloc.pairs_from_exhaustive"].main = stand_in.exhaustive
        modules["hloc.utils.io"].get_keypoints = stand_in.get_keypoints
        modules["hloc.utils.io"].get_matches = stand_in.get_matches
        for name, module in modules.items():
            module.__spec__ = importlib.machinery.ModuleSpec(name, None)
            monkeypatch.setitem(sys.modules, name, module)
        return stand_in

    return make


@pytest.fixture
def shown(corner, installed):
    """Five views of a corner of a room; of some of them no features are found."""

    def make(blind=(), shift=(0.0, 0.0)):
        scene, rng = corner(5, WIDTH, HEIGHT), np.random.default_rng(1)
        points = rng.uniform(-0.3, 0.7, (400, 3))
        axis = rng.integers(0, 3, len(points))
        points[:, 2] = np.abs(points[:, 2])
        points[np.arange(len(points)), axis] = np.array([0.7, 0.7, 0.0])[axis]
        Ks = scene.rig.Ks.copy()
        Ks[:, 1, 1] *= 1.15  # pixels are not square
        Ks[2, :2, 2] += shift
        keypoints, ids = [], []
        for i, (viewmat, K) in enumerate(zip(scene.rig.viewmats, Ks, strict=True)):
            camera = points @ viewmat[:3, :3].T + viewmat[:3, 3]
            pixels = (camera @ K.T)[:, :2] / camera[:, 2:]
            seen = np.flatnonzero(((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all(1))
            seen = rng.permutation(seen)[: 0 if i in blind else None]
            keypoints.append(pixels[seen].astype(np.float32) - np.float32(0.5))
            ids.append(seen)
        return scene, Ks, installed(Hloc(keypoints, ids))

    return make


def as_dark(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures.astype(np.float32) / 2550)


@pytest.mark.parametrize("mapper", ["incremental", "global"])
def test_aligned_cameras_are_the_true_ones_and_views_without_features_are_left_out(shown, mapper):
    scene, Ks, _ = shown(blind=[1], shift=(-9.0, 6.0))  # the third view has a lens of its own
    steps: list[tuple[int, int]] = []
    dark = as_dark(scene.pictures)
    dark[1] = 1  # no point is seen in this one
    found = hloc_cameras(
        scene.pictures, Ks, dark, n_points=150, config=HlocConfig(mapper=mapper),
        progress=lambda done, total, what: steps.append((done, total)),
    )  # fmt: skip
    assert found.registered == (0, 2, 3, 4)
    np.testing.assert_array_equal(found.Ks.numpy(), Ks[[0, 2, 3, 4]])
    aligned = align(found.viewmats, torch.tensor(scene.rig.viewmats)[[0, 2, 3, 4]])
    # Right matches are exact; wrong ones within 2 px of their epipolar line turn a camera by up to 0.034 degrees here,
    # keypoints off by the half pixel between the two conventions by 0.096.
    assert aligned.rotation_deg.max() < 0.05
    assert aligned.centre_error.max() < 3e-3
    assert found.made_of == {"of the sparse model": 150}
    assert 0 < found.colors.min() < found.colors.max() < 0.1
    off = scene.distance(aligned.similarity.apply(found.points.double()).numpy())
    # A wrong match can have triangulated; it was one of ten, and had to lie on the epipolar line.
    assert np.median(off) < 2e-3
    assert steps == sorted(steps)
    assert steps[0] == (0, 8)
    assert steps[-1] == (8, 8)


@pytest.mark.parametrize(
    ("config", "used"),
    [
        (HlocConfig(), ["feats-disk", "matches-disk-lightglue"]),
        (HlocConfig(features="sift"), ["feats-sift", "matches-NN-ratio"]),
        (HlocConfig(features="sift", matcher="superglue"), ["feats-sift", "matches-superglue"]),
    ],
)
def test_features_and_matcher_are_those_of_its_configurations(shown, config, used):
    scene, Ks, stand_in = shown()
    hloc_cameras(scene.pictures, Ks, as_dark(scene.pictures), n_points=10, config=config)
    assert stand_in.used == used


def test_the_same_seed_gives_the_same_cameras_and_torchs_own_stream_goes_on_untouched(shown):
    scene, Ks, stand_in = shown()
    torch.manual_seed(11)
    runs = [hloc_cameras(scene.pictures, Ks, as_dark(scene.pictures), n_points=10, seed=seed) for seed in (3, 3, 4)]
    after = torch.rand(1)
    assert torch.equal(runs[0].viewmats, runs[1].viewmats)
    assert torch.equal(runs[0].points, runs[1].points)
    assert stand_in.draws[0] == stand_in.draws[1] != stand_in.draws[2]
    torch.manual_seed(11)
    assert torch.equal(after, torch.rand(1))


def test_the_seed_reaches_the_check_of_matches_cameras_and_the_choice_of_points(shown, monkeypatch):
    """COLMAP is asked for the seed that it was given: with clean features most seeds give the same cameras."""
    verify, build, given = pycolmap.verify_matches, pycolmap.incremental_mapping, list[int]()

    def verified(*args, options, **rest):
        given.append(options.ransac.random_seed)
        return verify(*args, options=options, **rest)

    def built(database, pictures, out, options, **rest):
        given.append(options.random_seed)
        return build(database, pictures, out, options, **rest)

    monkeypatch.setattr(pycolmap, "verify_matches", verified)
    monkeypatch.setattr(pycolmap, "incremental_mapping", built)
    scene, Ks, _ = shown()
    found = [hloc_cameras(scene.pictures, Ks, as_dark(scene.pictures), n_points=40, seed=seed) for seed in (0, 7)]
    assert given == [0, 0, 7, 7]
    one, other = (align(e.viewmats, torch.tensor(scene.rig.viewmats)).similarity.apply(e.points) for e in found)
    # Another 40 of some 400 points, which are found again within 2e-3.
    assert (torch.cdist(one, other).amin(1) > 0.01).sum() > 20


def test_pictures_without_matches_are_refused_with_what_to_do(shown):
    scene, Ks, _ = shown(blind=range(5))
    with pytest.raises(ValueError, match=r"with disk registered 0 of 5 views of the raw pictures.*pictures=enhanced"):
        hloc_cameras(scene.pictures, Ks, as_dark(scene.pictures), n_points=10)


def test_files_that_are_not_as_expected_are_refused(shown):
    scene, Ks, stand_in = shown()
    dark = as_dark(scene.pictures)
    right, stand_in.keypoints = stand_in.keypoints, [k[:20] for k in stand_in.keypoints]
    with pytest.raises(ValueError, match=r"matches of 000000.png and 000001.png name features that are not there"):
        hloc_cameras(scene.pictures, Ks, dark, n_points=10)
    stand_in.keypoints = [np.concatenate([k, k], 1) for k in right]
    with pytest.raises(ValueError, match=r"hloc's keypoints must be \[n, 2\], got \[\d+, 4\]: use hloc 1.5"):
        hloc_cameras(scene.pictures, Ks, dark, n_points=10)


def test_without_the_package_or_with_a_part_of_it_one_line_says_what_to_do(shown, monkeypatch):
    scene, Ks, _ = shown()
    dark = as_dark(scene.pictures)
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "hloc.match_features", None)  # importing it then fails, as without h5py
        with pytest.raises(ValueError, match="match_features cannot be imported .*install the package it asks for"):
            hloc_cameras(scene.pictures, Ks, dark, n_points=10)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"package hloc, which is not installed: clone https://.*Hierarchical-Localization"
    ):
        hloc_cameras(scene.pictures, Ks, dark, n_points=10)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"features": "surf"}, "features of hloc must be one of disk, sift, got 'surf'"),
        ({"matcher": "glue"}, "matcher of hloc must be auto or one of NN-ratio, disk.*, superglue, got 'glue'"),
        ({"mapper": "local"}, "mapper of hloc must be one of incremental, global, got 'local'"),
        ({"pictures": "lit"}, "pictures of hloc must be one of raw, enhanced, denoised, got 'lit'"),
        ({"min_matches": 7}, "hloc needs min_matches >= 8"),
        ({"max_error": 0.0}, "max_error of hloc must be > 0"),
    ],
)
def test_impossible_settings_are_refused(shown, wrong, message):
    scene, Ks, _ = shown()
    with pytest.raises(ValueError, match=message):
        hloc_cameras(scene.pictures, Ks, as_dark(scene.pictures), n_points=10, config=HlocConfig(**wrong))
