"""A small capture of very little light, for whole fits."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from novags.methods.noise import camera_noise
from novags.methods.problem import Problem, RawPictures
from novags.splats.gaussians import Gaussians
from novags.splats.raster.rasterize import rasterize
from novags.splats.views import Views
from sensor_model.capture import expose
from sensor_model.isp import develop, white_balance
from sensor_model.params import Exposure
from sensor_model.presets import PRESETS

ELECTRONS = 2.0
SIZE, VIEWS, POINTS = 24, 6, 120


@dataclass(frozen=True)
class Start:
    """First points [P, 3] with colours [P, 3], and the scene extent."""

    points: Tensor
    colors: Tensor
    extent: float


@lru_cache
def problem() -> Problem:
    """A textured wall before six cameras that collect two electrons per pixel: raw frames, and developed to 8 bits."""
    stream = torch.Generator().manual_seed(0)
    points = torch.rand(POINTS, 3, generator=stream) * torch.tensor([2.4, 2.4, 0.3]) - torch.tensor([1.2, 1.2, 0.0])
    wall = Gaussians.from_points(points, torch.rand(POINTS, 3, generator=stream) * 0.8 + 0.1, sh_degree=0)
    viewmats = torch.eye(4).repeat(VIEWS, 1, 1)
    viewmats[:, 0, 3], viewmats[:, 2, 3] = torch.linspace(-0.5, 0.5, VIEWS), 3.0
    K = torch.tensor([[30.0, 0, SIZE / 2], [0, 30.0, SIZE / 2], [0, 0, 1]])
    views = Views(viewmats, K.repeat(VIEWS, 1, 1), SIZE, SIZE)
    light, _, _ = rasterize(
        wall.means, wall.quats, wall.scales, wall.opacities, wall.sh, views.viewmats, views.Ks, SIZE, SIZE, sh_degree=0
    )
    sensor, exposure = PRESETS["a7s2-iso6400-3chip"], Exposure(time=1 / 30)
    photons = light.double().numpy() * ELECTRONS / (float(light.mean()) * np.mean(sensor.eta))
    frames = [expose(view, sensor, exposure, seed=0, view=i) for i, view in enumerate(photons)]
    dark = np.stack([develop(frame, sensor).srgb8 for frame in frames]) / 255
    noise = camera_noise(sensor, exposure, demosaic="menon", color_matrix=None)
    pictures = torch.tensor(dark, dtype=torch.float32)
    start = Start(points + 0.02, pictures.mean((0, 1, 2)).expand(POINTS, 3).contiguous(), views.extent)
    dn = torch.from_numpy(np.stack([frame.dn for frame in frames]).astype(np.float32))
    red, green, blue = white_balance(sensor).tolist()
    raw = RawPictures(dn=dn, cfa=None, black=sensor.black_level, white=sensor.white_dn, balance=(red, green, blue))
    return Problem(views=views, srgb8=pictures, raw=raw, start=start, seed=0, noise=noise)
