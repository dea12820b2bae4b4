"""Hard cases of the cameras: centres on a line or at a point, mirrors, far frames, turns by nearly 180 degrees.

References: a known similarity, applied in mpmath; angles that are known because they were put in.
"""

import math
import sys
from typing import Any

import mpmath
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from novags.cameras import align as alignment
from novags.cameras.align import Alignment, Similarity, align, to_estimated
from novags.splats.training.updates.camera_refinement import refined
from simscenes import rigs
from simscenes.rigs import Rig, mitsuba_to_opencv, opencv_to_mitsuba
from tests.stability.case import Case, Error, Fails, Part, Setting, refusal, worse

PART = Part("cameras")
HERE = sys.modules[__name__]  # where the cases find what a test replaces
EPS64 = float(np.finfo(np.float64).eps)
EPS32 = float(np.finfo(np.float32).eps)
TURN = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()


def viewmats(centres: np.ndarray, turns: np.ndarray) -> Tensor:
    """World-to-camera matrices [C, 4, 4] of cameras at centres [C, 3] with rotations [C, 3, 3], rounded once."""
    made = np.tile(np.eye(4), (len(centres), 1, 1))
    with mpmath.workdps(40):
        for view, centre, turn in zip(made, centres, turns, strict=True):
            view[:3, :3] = turn
            shift = -(mpmath.matrix(turn.tolist()) * mpmath.matrix(centre.tolist()))
            view[:3, 3] = [float(x) for x in shift]
    return torch.from_numpy(made)


def turns(count: int, seed: int = 0) -> np.ndarray:
    """Random rotations [count, 3, 3]."""
    return np.asarray(Rotation.random(count, random_state=np.random.default_rng(seed)).as_matrix())


def _recovered(centres: np.ndarray, scale: float, shift: float = 0.0, seed: int = 0) -> float:
    """How far `align` is from a known similarity: scale relative, rotation, and translation in scene extents."""
    rotations = turns(len(centres), seed)
    offset = shift * np.array([0.6, -0.5, 0.3])
    # The true centre is scale * TURN @ estimated + offset; a camera's rotation turns back.
    true = viewmats(scale * centres @ TURN.T + offset, rotations @ TURN.T)
    found = align(viewmats(centres, rotations), true).similarity
    extent = scale * float(np.ptp(centres, axis=0).max())
    moved = float(np.abs(found.apply(torch.from_numpy(centres)).numpy() - scale * centres @ TURN.T - offset).max())
    turned = float(np.abs(found.rotation.numpy() - TURN).max())
    return worse(abs(found.scale / scale - 1), turned, moved / extent)


@PART.case("Sim(3) of cameras on a line, at scales of 1e-6 to 1e6", bound=20 * EPS64, unit="of the extent")
def _(setting: Setting) -> float:
    line = np.linspace(-1, 1, 7)[:, None] * np.array([1.0, 2, -1])
    return worse(*(_recovered(line, scale) for scale in (1e-6, 1.0, 1e6)))


@PART.case("Sim(3) of two cameras, and of all but one at the same point", bound=20 * EPS64, unit="of the extent")
def _(setting: Setting) -> float:
    two, most = np.array([[0.0, 0, 0], [1, 2, 3]]), np.tile([[0.3, 0.1, -0.2]], (8, 1))
    most[5] = (1.0, -1.0, 0.5)
    return worse(_recovered(two, 3.0), _recovered(most, 0.2))


# Centres come from translations, whose digits end at EPS64 * offset: EPS64 * 5e6 of an extent, a few times.
@PART.case("Sim(3) to a frame 5e6 extents away", bound=10 * 5e6 * EPS64, unit="of the extent")
def _(setting: Setting) -> float:
    centres = np.random.default_rng(1).uniform(-0.5, 0.5, (9, 3))
    return _recovered(centres, 1.0, shift=5e6)


@PART.case("Sim(3) of mirrored centres: a rotation all the same", bound=20 * EPS64, unit="of orthonormal")
def _(setting: Setting) -> float:
    centres = np.random.default_rng(2).normal(0, 1, (60, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)  # turns that agree with nothing leave them the say
    found = align(viewmats(centres, turns(60)), viewmats(centres * [1.0, 1, -1], turns(60, seed=1))).similarity
    rotation = found.rotation.numpy()
    proper = abs(float(np.linalg.det(rotation)) - 1)
    return worse(proper, float(np.abs(rotation @ rotation.T - np.eye(3)).max()), 0.0 if found.scale > 0 else math.inf)


@PART.case("Sim(3) of one camera, or of all at one point: refused", bound=0, unit="refused")
def _(setting: Setting) -> float:
    same = viewmats(np.tile([[5.0, 1, 2]], (4, 1)), turns(4))
    apart = viewmats(np.random.default_rng(0).normal(0, 1, (4, 3)), turns(4))
    return worse(
        refusal(lambda: align(same[:1], apart[:1]), "2 or more cameras"),
        refusal(lambda: align(same, apart), "estimated cameras all stand at one point", "scale"),
        refusal(lambda: align(apart, same), "true cameras all stand at one point"),
        refusal(lambda: align(apart * math.nan, apart), "finite"),
    )


def _turned(angle: float) -> Alignment:
    """Ten cameras, one of them turned by an angle."""
    centres, rotations = np.random.default_rng(3).normal(0, 1, (10, 3)), turns(10)
    moved = rotations.copy()
    moved[4] = _rotation(angle) @ rotations[4]
    return align(viewmats(centres, moved), viewmats(centres, rotations))


def _rotation(angle: float) -> np.ndarray:
    """By `angle` about a skew axis, rounded from 40 digits."""
    with mpmath.workdps(40):
        x, y, z = (mpmath.mpf(k) / 7 for k in (2, 3, 6))  # of length 1
        K = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        R = mpmath.eye(3) + mpmath.sin(mpmath.mpf(angle)) * K + (1 - mpmath.cos(mpmath.mpf(angle))) * K * K
        return np.array(R.tolist(), dtype=np.float64)


# A chord is exact to a few EPS64; at 170 degrees the arc sine makes 12 times that of it.
@PART.case("a camera turned by 1e-6 rad to 170 degrees: its angle", bound=50 * EPS64, unit="rad")
def _(setting: Setting) -> float:
    found = [(angle, math.radians(float(_turned(angle).rotation_deg[4]))) for angle in (1e-6, 1e-3, 1.0, 2.97)]
    return worse(*(abs(angle - seen) for angle, seen in found))


# At 180 degrees the chord is at its longest: a rounding of e changes the angle by sqrt(8 e).
@PART.case("a camera turned by 180 degrees, and by 1e-7 rad less", bound=10 * math.sqrt(EPS64), unit="rad")
def _(setting: Setting) -> float:
    found = [(angle, math.radians(float(_turned(angle).rotation_deg[4]))) for angle in (math.pi, math.pi - 1e-7)]
    return worse(*(abs(angle - seen) for angle, seen in found))


@PART.case("there and back: similarities of scale 1e-6 and 1e6, turned by 180 degrees", bound=20 * EPS64,
           unit="of the distance")  # fmt: skip
def _(setting: Setting) -> float:
    cameras = viewmats(np.random.default_rng(4).normal(0, 3, (6, 3)), turns(6))
    worst = 0.0
    for scale in (1e-6, 1e6):
        there = Similarity(
            scale, torch.from_numpy(_rotation(math.pi)), torch.tensor([4.0, -2.0, 1.0], dtype=torch.float64)
        )
        back = to_estimated(there.inverse(), to_estimated(there, cameras.double()))
        worst = worse(worst, float((back - cameras).abs().max()) / float(cameras.abs().max()))
    return worst


# A rotation is exact; the translation goes through the centre and back, each a sum of three products.
@PART.case("frames of Mitsuba and back, 5e6 units away", bound=10 * 5e6 * EPS64, unit="units")
def _(setting: Setting) -> float:
    centres = 5e6 + np.random.default_rng(5).normal(0, 1, (6, 3))
    cameras = viewmats(centres, turns(6)).numpy()
    back = mitsuba_to_opencv(opencv_to_mitsuba(cameras))
    return float(np.abs(back - cameras).max())


@PART.case("pixels of points at the camera's plane and behind it", bound=0, unit="wrong")
def _(setting: Setting) -> float:
    """No number may make a point behind a camera look as if it were in front: its depth stays at 0 or below."""
    K = np.array([[50.0, 0, 16], [0, 50.0, 16], [0, 0, 1]])
    rig = Rig(viewmats=np.eye(4)[None], Ks=K[None], width=32, height=32)
    pixels, depth = rig.project(np.array([[0, 0, 0], [1, 1, 0], [0, 0, -1e-300], [0, 0, -2], [0, 0, 5e-324]]))
    wrong = (depth[0] > 0) != [False, False, False, False, True]
    return float(wrong.sum() + (not np.isnan(pixels[0, 0]).all()) + (not np.isinf(pixels[0, 1]).all()))


@PART.case("refined cameras: twists of 0, 1e-20, 1e-4 and 3, values and gradients", bound=8 * EPS32,
           unit="of the largest value")  # fmt: skip
def _(setting: Setting) -> float:
    """The quaternion (1, w / 2), written out in float64; at zero its gradient is that of the cross product."""
    base = viewmats(np.random.default_rng(6).normal(0, 2, (4, 3)), turns(4))
    worst = 0.0
    for size in (0.0, 1e-20, 1e-4, 3.0):
        twists = size * torch.from_numpy(np.random.default_rng(7).normal(0, 1, (4, 6)))
        weights = torch.from_numpy(np.random.default_rng(8).normal(0, 1, (4, 4, 4)))
        found: list[Tensor] = []
        wanted: list[Tensor] = []
        for dtype, function, into in ((torch.float32, refined, found), (torch.float64, _refined, wanted)):
            leaf = twists.to(dtype).requires_grad_()
            value = function(base.to(dtype), leaf, 2.5)
            (value * weights.to(dtype)).sum().backward()
            assert leaf.grad is not None
            into += [value.detach().double(), leaf.grad.double()]
        for a, b in zip(found, wanted, strict=True):
            worst = worse(worst, float((a - b).abs().max() / b.abs().max()) if bool(a.isfinite().all()) else math.inf)
    return worst


def _refined(views: Tensor, twists: Tensor, extent: float) -> Tensor:
    """Rodrigues' formula for tan(angle / 2) along w / 2: R = ((1 - q.q) I + 2 q q^T + 2 [q]) / (1 + q.q)."""
    q, eye = twists[:, :3] / 2, torch.eye(3, dtype=torch.float64)
    square = (q * q).sum(1)[:, None, None]
    cross = torch.stack([torch.linalg.cross(q, eye[k].expand_as(q), dim=1) for k in range(3)], -1)
    R = ((1 - square) * eye + 2 * q[:, :, None] * q[:, None, :] + 2 * cross) / (1 + square)
    shifted = views[:, :3, 3:] - extent * twists[:, 3:, None]
    top = R @ torch.cat([views[:, :3, :3], shifted], 2)
    return torch.cat([top, views[:, 3:]], 1)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


fitted, nearest = alignment._fit, alignment._nearest_rotations


def from_centres_alone(estimated: Any, true: Any, extent: float) -> Any:
    """Umeyama (1991): leaves the turn about a line of cameras open."""
    blind = true.copy()
    blind[..., :3, :3] = np.eye(3)
    there = estimated.copy()
    there[..., :3, 3] = -alignment.centers_of(estimated.reshape(-1, 4, 4)).reshape(*estimated.shape[:2], 3)
    blind[..., :3, 3] = -alignment.centers_of(true.reshape(-1, 4, 4)).reshape(*true.shape[:2], 3)
    there[..., :3, :3] = np.eye(3)
    return fitted(there, blind, extent)


def improper(matrices: Any) -> Any:
    U, _, Vt = np.linalg.svd(matrices)
    return U @ Vt


def by_arc_cosine(self: Any, estimated: Any, true: Any, extent: float) -> Any:
    turned = estimated[None, :, :3, :3] @ self.rotations.transpose(0, 2, 1)[:, None]
    trace = (turned * true[:, :3, :3]).sum((-1, -2))
    _, distances = whole_errors(self, estimated, true, extent)
    return np.arccos(np.clip((trace - 1) / 2, -1, 1)), distances


whole_errors = alignment._Fits.errors


def inverse_in_float32(pose: Any) -> Any:
    return np.linalg.inv(np.asarray(pose, np.float32)).astype(np.float64)


def exponential(viewmats: Any, twists: Any, extent: float) -> Any:
    angle = twists[:, :3].norm(dim=1)[:, None]
    x, y, z = (twists[:, :3] / angle).unbind(1)
    zero = torch.zeros_like(x)
    K = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    R = torch.eye(3) + torch.sin(angle)[..., None] * K + (1 - torch.cos(angle))[..., None] * K @ K
    t = viewmats[:, :3, 3] - extent * twists[:, 3:]
    top = R @ torch.cat([viewmats[:, :3, :3], t[..., None]], 2)
    return torch.cat([top, viewmats[:, 3:].expand(len(top), 1, 4)], 1)


def mirrored(self: Any, points: Any) -> Any:
    pixels, depth = whole_projection(self, points)
    return pixels, np.abs(depth)


whole_projection = rigs.Rig.project


@pytest.mark.parametrize(
    ("owner", "name", "naive", "start"),
    [
        (alignment, "_fit", from_centres_alone, "Sim(3) of cameras on a line"),
        (alignment, "_fit", from_centres_alone, "Sim(3) of two cameras"),
        (alignment, "_nearest_rotations", improper, "Sim(3) of mirrored"),
        (alignment._Fits, "errors", by_arc_cosine, "a camera turned by 1e-6"),
        (HERE, "align", lambda a, b: None, "Sim(3) of one camera"),
        (rigs, "invert_rigid", inverse_in_float32, "frames of Mitsuba"),
        (HERE, "refined", exponential, "refined cameras"),
        (rigs.Rig, "project", mirrored, "pixels of points"),
    ],
)
def test_a_formula_as_first_written_exceeds_its_bound(
    owner: Any, name: str, naive: Any, start: str, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not fails(start)
    monkeypatch.setattr(owner, name, naive)
    assert fails(start)


def test_cameras_in_float32_lose_a_frame_far_away(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = align
    monkeypatch.setattr(HERE, "align", lambda a, b: whole(a.float(), b.float()))
    assert fails("Sim(3) to a frame 5e6 extents away")
