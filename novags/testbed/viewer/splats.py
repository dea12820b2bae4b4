"""A run's scene: its Gaussians as the browser draws them, and any kind as seen from any camera of the viewer."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from novags.cameras.align import Similarity, to_estimated
from novags.cameras.estimate import Array
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.nerf.scene import load_field
from novags.methods.problem import encode
from novags.methods.reconstruction import ReconstructedScene
from novags.methods.rivals.denoised_scene import with_denoiser
from novags.methods.rivals.le3d.colours import with_colours
from novags.methods.saved import saved_gaussians
from novags.methods.variant.several import FITS, MeanScene, places
from novags.splats.raster.raster_torch import quat_to_rotmat
from novags.splats.sh import sh_to_rgb
from novags.splats.views import Views
from novags.testbed.folders.run import SCENE, Run


@dataclass(frozen=True)
class Drawn:
    """Gaussians as the browser draws them: of one colour from every side.

    Attributes:
        centers: [N, 3] float32.
        covariances: [N, 3, 3] float32.
        colors: [N, 3] float32, sRGB code, 0..1.
        opacities: [N, 1] float32, 0..1.
    """

    centers: np.ndarray
    covariances: np.ndarray
    colors: np.ndarray
    opacities: np.ndarray


def drawn(scene: GaussianScene, into: Similarity, gain: float | None = None) -> Drawn:
    """Gaussians in the frame that `into` leads to, in the constant part of their colours.

    Args:
        scene: In a frame of its own.
        into: From that frame.
        gain: Of Gaussians in linear light: to the light that is encoded for the screen. Blending in code is not quite
            blending in light.
    """
    g = scene.gaussians.detach()
    axes = into.scale * (into.rotation @ quat_to_rotmat(g.quats.double())) * g.scales.double()[:, None]
    base = sh_to_rgb(g.sh[:, 0]).float()
    colors = (base if scene.response is None else scene.response.codes(base)).numpy()
    if gain is not None and scene.matrix is not None:
        colors = colors @ scene.matrix.numpy().T
    return Drawn(
        into.apply(g.means).float().numpy(),
        (axes @ axes.mT).float().numpy(),
        np.clip(colors, 0, 1) if gain is None else encode(gain * colors),
        g.opacities.float().numpy()[:, None],
    )


def scene_of(run: Run) -> ReconstructedScene | None:
    """The scene of a run as it rendered it: Gaussians, a field, or several of them; None where it is of another kind.

    Raises:
        ValueError: If its file is damaged.
    """
    if (fits := run.record.get(FITS)) is not None:
        each = zip(places(run.path, len(fits)), fits, strict=True)
        scenes = [scene_of(replace(run, path=place, record=facts)) for place, facts in each]
        known = [scene for scene in scenes if scene is not None]
        return MeanScene(known) if len(known) == len(fits) else None
    gaussians = gaussians_of(run)
    if gaussians is None:
        return load_field(run.path)
    coloured = with_colours(gaussians, run.path)
    return with_denoiser(gaussians, run.path) if coloured is gaussians else coloured


def gaussians_of(run: Run) -> GaussianScene | None:
    """The Gaussians of a run, to be splatted as it did; None for methods that made none.

    Raises:
        ValueError: If its file is damaged.
    """
    path = run.path / SCENE
    return saved_gaussians(path, run.record) if path.is_file() else None


def rendered(
    scene: ReconstructedScene, into: Similarity, viewmat: Array, fov_y: float, size: tuple[int, int]
) -> np.ndarray:
    """A picture of a scene.

    Args:
        scene: In a frame of its own.
        into: From that frame to the viewer's.
        viewmat: World to camera, in the viewer's frame [4, 4].
        fov_y: Vertical field of view, radians.
        size: Width and height, pixels.

    Returns:
        float32 [h, w, 3], in the scene's own space.
    """
    width, height = size
    focal = height / 2 / math.tan(fov_y / 2)
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float32)
    camera = to_estimated(into, torch.from_numpy(viewmat)[None]).float()
    image: np.ndarray = scene.render(Views(camera, K[None], width, height))[0][0].numpy()
    return image
