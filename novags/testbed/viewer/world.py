"""The viewer's own frame: the true world moved and scaled, so that every scene has the same size on the screen.

X_viewer = scale * (X_true - middle). Browsers hold the covariances of Gaussians as 16-bit floats, which neither
millimetres nor kilometres fit into.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from novags.cameras.align import IDENTITY, Similarity, align, to_true
from novags.cameras.estimate import Array, centers_of, extent_of
from novags.testbed.folders import shapes
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.run import CAMERAS, Run
from novags.testbed.stages.camera_source import true_cameras
from sensor_model.files.reading import brief
from sensor_model.files.records import read_record

SIZE = 3.0  # viewer units from the mean camera to the outermost one, and a tenth


@dataclass(frozen=True)
class World:
    """The viewer's frame for one capture.

    Attributes:
        from_true: From the true frame, with its zero at `origin_of` the capture.
        viewmats: The true cameras in the viewer's frame [C, 4, 4] float64.
        up: Unit vector.
    """

    from_true: Similarity
    viewmats: Array
    up: tuple[float, float, float]

    @staticmethod
    def of(capture: Capture, upright: bool) -> "World":
        """The frame around a capture's cameras.

        Up is the upward direction of the mean picture; with `upright` the axis of the true world that is nearest to
        that.
        """
        true = true_cameras(capture).numpy()
        extent = extent_of(true)
        # The cameras' target lies about one extent before their middle; of a ring it is below the middle or in it.
        middle = centers_of(true).mean(0) + extent * true[:, 2, :3].mean(0)
        scale = SIZE / extent
        turn = torch.eye(3, dtype=torch.float64)
        from_true = Similarity(scale, turn, torch.from_numpy(-scale * middle))
        up = -true[:, 1, :3].mean(0)
        if upright or not np.linalg.norm(up) > 1e-6:  # cameras that are upside down to each other agree on no up
            axis = int(np.argmax(np.abs(up)))
            up = np.sign(up[axis]) * np.eye(3)[axis] if np.any(up) else np.eye(3)[2]
        x, y, z = up / np.linalg.norm(up)
        return World(from_true, to_true(from_true, torch.from_numpy(true)).numpy(), (float(x), float(y), float(z)))

    def nearest(self, viewmat: Array) -> int:
        """The view whose camera is nearest to this one [4, 4]: in angle, and in distance per `SIZE`, weighted alike."""
        cosines = (np.trace(self.viewmats[:, :3, :3] @ viewmat[:3, :3].T, axis1=1, axis2=2) - 1) / 2
        distances = np.linalg.norm(centers_of(self.viewmats) - centers_of(viewmat[None]), axis=1) / SIZE
        return int(np.argmin(np.hypot(np.arccos(np.clip(cosines, -1, 1)), distances)))


LARGEST = 1e12  # of a camera: float64 then still resolves a tenth of a millimetre in metres


def own_cameras(run: Run) -> tuple[list[str], Tensor] | None:
    """Names and matrices [R, 4, 4] float64 of the training cameras in a run's frame; None if it did not write them.

    Raises:
        ValueError: If the file is damaged.
    """
    path = run.path / CAMERAS
    if not path.is_file():
        return None
    listed = read_record(path, shapes.VIEWER_CAMERAS, "reconstruct again")
    turns = np.array([camera["rotation"] for camera in listed], np.float64).reshape(-1, 3, 3).transpose(0, 2, 1)
    places = np.array([camera["position"] for camera in listed], np.float64).reshape(-1, 3)
    if (most := max(np.abs(turns).max(initial=0), np.abs(places).max(initial=0))) > LARGEST:
        raise ValueError(f"{path} must hold positions and rotations up to {LARGEST:g}, got {most:g}: reconstruct again")
    viewmats = np.tile(np.eye(4), (len(listed), 1, 1))
    viewmats[:, :3, :3], viewmats[:, :3, 3] = turns, -np.einsum("cij,cj->ci", turns, places)
    return [camera["img_name"] for camera in listed], torch.from_numpy(viewmats)


def true_from(run: Run, capture: Capture) -> Similarity:
    """From the frame of a run to the true one; the identity for runs that did not write their cameras.

    Raises:
        ValueError: If its cameras are damaged, or are not the capture's.
    """
    found = own_cameras(run)
    if found is None:
        return IDENTITY
    names, viewmats = found
    if unknown := [name for name in names if name not in capture.names]:
        raise ValueError(f"{run.path / CAMERAS} names {brief(unknown[0], 100)}, which is not a view of {capture.path}: "
                         "reconstruct again")  # fmt: skip
    return align(viewmats, true_cameras(capture)[[capture.names.index(name) for name in names]]).similarity
