"""Where a reconstruction's cameras come from, and how their frame relates to the true one."""

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from novags.cameras import check_cameras, source_of
from novags.cameras.align import Alignment, align, to_estimated
from novags.cameras.estimate import CameraEstimate, near_origin
from novags.cameras.estimating import estimate_cameras
from novags.cameras.source import CameraConfig
from novags.methods.problem import stacked
from novags.splats.views import Views
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.set import Source
from novags.testbed.stages.failing import failing_in
from novags.testbed.stages.seen import SEEN
from simscenes.rigs import Rig


def cameras_of(
    config: CameraConfig,
    capture: Capture,
    source: Source,
    indices: list[int],
    points: int,
    seed: int,
    device: torch.device,
    console: Console,
) -> CameraEstimate:
    """Cameras of some views of a capture, and first points, from the source that `config` belongs to.

    They are found once for all methods that ask for the same while the capture is open, and copied for each.

    Raises:
        ValueError: If the source cannot place at least two views, or is not installed.
    """
    with failing_in("cameras"):
        check_cameras(config)
        asked = ("cameras", config, source.content, tuple(indices), points, seed, device)
        found = capture.memo.once(
            asked, lambda: _found(config, capture, source, indices, points, seed, device, console)
        )
    return copy.deepcopy(found)


def _found(
    config: CameraConfig, capture: Capture, source: Source, indices: list[int], points: int, seed: int,
    device: torch.device, console: Console,
) -> CameraEstimate:  # fmt: skip
    dark = stacked(capture.srgb8, indices)
    views = capture.cameras.about(origin_of(capture))
    if source_of(config).takes == "set":
        if not source.scaled:  # depth for the first points; its cameras differ from the capture's by rounding
            views = dataclasses.replace(source.views, rig=capture.cameras.rig).about(origin_of(capture))
        return estimate_cameras(config, views, indices, dark, n_points=points, seed=seed)
    with console.progress("cameras") as progress:
        pictures = np.stack(list(SEEN[config.looks_at](tuple(dark), seed)))
        return estimate_cameras(
            config, views, indices, dark, pictures=pictures, n_points=points, seed=seed, device=device,
            progress=progress,
        )  # fmt: skip


@dataclass(frozen=True)
class CoordinateFrame:
    """The coordinate frame of a reconstruction, and the true cameras in it.

    True cameras are the capture's, seen from `origin_of` it.

    Attributes:
        capture: The capture.
        indices: Of the capture's views, the training views that have a camera.
        rig: Those cameras at the end of training, with the intrinsics of their source, which may estimate them too.
        alignment: Of these cameras to the true ones.
    """

    capture: Capture
    indices: list[int]
    rig: Rig
    alignment: Alignment

    @staticmethod
    def of(
        capture: Capture, indices: list[int], estimate: CameraEstimate, viewmats: Tensor | None
    ) -> "CoordinateFrame":
        """The frame of an estimate, or of the cameras that training refined it to (`viewmats` [R, 4, 4])."""
        rig = estimate.rig
        if viewmats is not None:
            rig = dataclasses.replace(rig, viewmats=viewmats.detach().cpu().double().numpy())
        return CoordinateFrame(capture, indices, rig, align(torch.tensor(rig.viewmats), true_cameras(capture)[indices]))

    def view(self, i: int, device: torch.device) -> Views:
        """The camera of view `i` in this frame: the method's own of a training view, else the true one brought here."""
        if i in self.indices:
            place = self.indices.index(i)
            return views_of(self.rig, [place]).to(device)
        there = to_estimated(self.alignment.similarity, true_cameras(self.capture)[i : i + 1]).numpy()
        true = self.capture.cameras.rig
        return views_of(dataclasses.replace(true, viewmats=there, Ks=true.Ks[i : i + 1])).to(device)

    def facts(self) -> dict[str, Any]:
        """For the record: which views have a camera, how large the errors are after alignment, the depth scale.

        `origin` is there where the set lies far from zero: add it to coordinates of the true frame (as in
        point_cloud.ply with cameras "known") to get the set's own, which float32 could not hold.
        """
        names, train = self.capture.names, self.capture.cameras.train_indices
        found = self.alignment
        return {
            "registered": [names[i] for i in self.indices],
            "unregistered": [names[i] for i in train if i not in self.indices],
            "registered_share": len(self.indices) / len(train),
            "rotation_deg": [float(v) for v in found.rotation_deg],
            "centre_error": [float(v) for v in found.centre_error],
            "mean_rotation_deg": float(found.rotation_deg.mean()),
            "mean_centre_error": float(found.centre_error.mean()),
            "depth_scale": float(found.similarity.scale),
            **({"origin": list(origin)} if any(origin := origin_of(self.capture)) else {}),
        }


def views_of(rig: Rig, chosen: list[int] | None = None) -> Views:
    """Cameras, or the chosen ones, for the rasteriser, which works in float32."""
    which = slice(None) if chosen is None else chosen
    viewmats, Ks = (torch.tensor(values[which], dtype=torch.float32) for values in (rig.viewmats, rig.Ks))
    return Views(viewmats, Ks, rig.width, rig.height)


def true_cameras(capture: Capture) -> Tensor:
    """World-to-camera matrices of all views [C, 4, 4] float64, in a world whose zero is at `origin_of` the capture."""
    viewmats = np.array(capture.cameras.rig.viewmats, np.float64)
    if any(origin := near_origin(viewmats)):
        viewmats[:, :3, 3] += viewmats[:, :3, :3] @ origin
    return torch.from_numpy(viewmats)


def origin_of(capture: Capture) -> tuple[float, float, float]:
    """Where the origin of reconstructions lies in the capture's coordinates: not at zero if the set is far from it."""
    return near_origin(np.asarray(capture.cameras.rig.viewmats, np.float64))


def viewer_cameras(names: Sequence[str], views: Sequence[Views]) -> list[dict[str, Any]]:
    """cameras.json of 3DGS: position and rotation from camera to world, OpenCV axes, focal lengths in pixels."""
    listed = []
    for i, (name, view) in enumerate(zip(names, views, strict=True)):
        turn = view.viewmats[0, :3, :3].double().cpu().numpy().T
        place = -turn @ view.viewmats[0, :3, 3].double().cpu().numpy()
        fx, fy = (float(view.Ks[0, k, k]) for k in (0, 1))
        size = {"width": view.width, "height": view.height}
        pose = {"position": place.tolist(), "rotation": np.asarray(turn).tolist()}
        listed.append({"id": i, "img_name": name, **size, **pose, "fy": fy, "fx": fx})
    return listed
