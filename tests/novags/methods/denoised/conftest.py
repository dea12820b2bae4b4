"""A small problem whose noise is known."""

import numpy as np
import pytest
import torch

from novags.methods.noise import camera_noise
from novags.methods.problem import Problem, RawPictures, encode
from novags.splats import Views
from sensor_model import PRESETS, Exposure, develop, develop_linear, expose, from_linear16
from sensor_model.isp import white_balance

EXPOSURE = Exposure(time=1 / 30)


class Points:
    points = torch.rand(30, 3, generator=torch.Generator().manual_seed(0)) - 0.5 + torch.tensor([0.0, 0.0, 3.0])
    colors = torch.full((30, 3), 0.2)
    extent = 1.0


@pytest.fixture(scope="module")
def problem() -> Problem:
    sensor = PRESETS["a7s2-iso6400-3chip"]
    y, x = np.mgrid[:24, :32] / 8.0
    clean = np.stack([12 + 6 * np.sin(x), 20 + 9 * np.sin(y), 14 + 5 * np.cos(x + y)], -1)
    frames = [expose(clean / sensor.eta, sensor, EXPOSURE, seed=4, view=i) for i in range(3)]
    developed = [develop(f, sensor) for f in frames]
    K = torch.tensor([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]]).expand(3, 3, 3)
    red, green, blue = white_balance(sensor).tolist()
    return Problem(
        views=Views(torch.eye(4).repeat(3, 1, 1), K, 32, 24), start=Points(), seed=5,
        srgb8=torch.from_numpy(np.stack([d.srgb8 for d in developed]) / 255).float(),
        linear16=torch.from_numpy(np.stack([from_linear16(d.linear16) for d in developed])),
        raw=RawPictures(dn=torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32)), cfa=None,
                        black=sensor.black_level, white=sensor.white_dn, balance=(red, green, blue)),
        noise=camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=None),
        clean=torch.from_numpy(np.stack([encode(develop_linear(f.clean_dn, sensor)) for f in frames])),
    )  # fmt: skip
