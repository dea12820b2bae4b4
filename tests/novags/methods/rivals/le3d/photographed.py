"""A textured wall of 96 x 96 px in the dark, photographed by a camera with one chip behind a Bayer mosaic, or three."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from novags.methods.noise import camera_noise
from novags.methods.problem import Problem, RawPictures
from novags.splats import Gaussians, Views, rasterize
from sensor_model import PRESETS, Exposure, develop, expose, from_linear16
from sensor_model.isp import white_balance
from sensor_model.mosaicking import mosaic

Camera = Literal["a7s2-iso6400", "a7s2-iso6400-3chip"]
CAMERAS: tuple[Camera, ...] = ("a7s2-iso6400", "a7s2-iso6400-3chip")
SIZE, VIEWS, POINTS = 96, 4, 600
ELECTRONS = 30.0  # of the brightest part
EXPOSURE = Exposure(time=1 / 30)


@dataclass(frozen=True)
class WallPoints:
    points: Tensor
    colors: Tensor
    extent: float


def cameras() -> Views:
    viewmats = torch.eye(4).repeat(VIEWS, 1, 1)
    viewmats[:, 0, 3] = torch.linspace(-0.4, 0.4, VIEWS)
    viewmats[:, 2, 3] = 3.0
    K = torch.tensor([[120.0, 0, SIZE / 2], [0, 120.0, SIZE / 2], [0, 0, 1]])
    return Views(viewmats, K.repeat(VIEWS, 1, 1), SIZE, SIZE)


def photographed(camera: Camera, seed: int = 0) -> tuple[Problem, Tensor]:
    """The problem, and its light without noise [C, H, W, 3] in the unit of the linear pictures."""
    sensor, views = PRESETS[camera], cameras()
    g = torch.Generator().manual_seed(7)
    points = torch.cat([2.6 * torch.rand(POINTS, 2, generator=g) - 1.3, 0.2 * torch.rand(POINTS, 1, generator=g)], 1)
    wall = Gaussians.from_points(points, torch.rand(POINTS, 3, generator=g) * 0.8 + 0.1, sh_degree=0)
    lit, _, _ = rasterize(
        wall.means, wall.quats, wall.scales, wall.opacities, wall.sh, views.viewmats, views.Ks, SIZE, SIZE, sh_degree=0
    )
    balance = white_balance(sensor)
    electrons = ELECTRONS * lit.double().numpy() / balance  # of a white wall in the light for which balance is right
    seen = electrons if sensor.cfa is None else np.stack([mosaic(view, sensor.cfa) for view in electrons])
    frames = [expose(view / sensor.eta, sensor, EXPOSURE, seed=seed, view=i) for i, view in enumerate(seen)]
    developed = [develop(frame, sensor) for frame in frames]
    red, green, blue = balance.tolist()
    srgb8 = torch.from_numpy(np.stack([d.srgb8 for d in developed]) / 255).float()
    problem = Problem(
        views=views, start=WallPoints(points + 0.02, srgb8.mean((0, 1, 2)).expand(POINTS, 3).contiguous(), 1.0),
        seed=seed, srgb8=srgb8,
        linear16=torch.from_numpy(np.stack([from_linear16(d.linear16) for d in developed])),
        raw=RawPictures(dn=torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32)), cfa=sensor.cfa,
                        black=sensor.black_level, white=sensor.white_dn, balance=(red, green, blue)),
        noise=camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=None),
    )  # fmt: skip
    light = electrons * balance * sensor.gain / (sensor.white_dn - sensor.black_level)
    return problem, torch.from_numpy(light).float()
