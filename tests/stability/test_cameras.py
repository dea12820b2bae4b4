"""Every hard case of the cameras holds; and with each formula as one would first write it, its case does not."""

from typing import Any

import numpy as np
import pytest
import torch

from novags.cameras import align as alignment
from novags.testbed.stability import PARTS, Case, Setting, measured
from novags.testbed.stability.parts import cameras as cases
from simscenes import rigs


def test_the_error_stays_within_its_bound(case: Case, setting: Setting) -> None:
    found = measured(case, setting)
    assert found.holds, str(found)


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
        (cases, "align", lambda a, b: None, "Sim(3) of one camera"),
        (rigs, "invert_rigid", inverse_in_float32, "frames of Mitsuba"),
        (cases, "refined", exponential, "refined cameras"),
        (rigs.Rig, "project", mirrored, "pixels of points"),
    ],
)
def test_a_formula_as_first_written_exceeds_its_bound(
    owner: Any, name: str, naive: Any, start: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (case,) = [case for case in PARTS["cameras"].cases if case.name.startswith(start)]
    assert measured(case, Setting("torch", 1)).holds
    monkeypatch.setattr(owner, name, naive)
    assert not measured(case, Setting("torch", 1)).holds


def test_cameras_in_float32_lose_a_frame_far_away(monkeypatch: pytest.MonkeyPatch) -> None:
    (case,) = [case for case in PARTS["cameras"].cases if "5e6 extents" in case.name]
    whole = cases.align
    monkeypatch.setattr(cases, "align", lambda a, b: whole(a.float(), b.float()))
    assert not measured(case, Setting("torch", 1)).holds
