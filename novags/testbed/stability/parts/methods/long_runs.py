"""Long runs: 20,000 iterations at two electrons, with the norm of every group of parameters on record."""

import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from novags.methods import METHODS, chosen
from novags.methods.noise import camera_noise
from novags.methods.problem import Problem, RawPictures
from novags.splats.gaussians import Gaussians
from novags.splats.raster.rasterize import rasterize
from novags.splats.training.fit import LOG_EVERY
from novags.splats.views import Views
from novags.testbed.presets import EXPERIMENTS
from novags.testbed.stability.case import Part, Setting
from sensor_model.capture import expose
from sensor_model.isp import develop, white_balance
from sensor_model.params import Exposure
from sensor_model.presets import PRESETS

PART = Part("long_runs")

ITERATIONS, ELECTRONS = 20_000, 2.0
SIZE, VIEWS, POINTS = 24, 6, 120
# Largest root mean squares that are still ordinary: log scales and logits of the range that `splats` covers, and
# what Adam can move a quaternion or a colour at its rate in so many iterations; positions in world units.
LARGEST = {"means": 50.0, "quats": 20.0, "log_scales": 40.0, "logit_opacities": 100.0, "sh": 50.0}


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


def _largest_ratio(name: str) -> float:
    """The largest norm of a group on record over what it may be; infinite where one is missing or not finite."""
    variant = chosen(name)
    config = variant.config(METHODS[variant.method].config(), {"init_scale": 0.7, "fit.rates.schedule": "gsplat"})
    config = dataclasses.replace(config, fit=dataclasses.replace(config.fit, iterations=ITERATIONS, sh_degree=1))
    counts = {"means": 3, "quats": 4, "log_scales": 3, "logit_opacities": 1, "sh": 12}
    records: list[tuple[int, int, dict[str, float]]] = []
    result = METHODS[variant.method].train(problem(), config, progress=lambda *record: records.append(record))
    done, total = [0, *(record[0] for record in records)], {record[1] for record in records}
    steps = [after - before for before, after in pairwise(done)]
    if {done[-1]} != total or not all(0 < step <= LOG_EVERY for step in steps):  # part of it is not on record
        return math.inf
    if not all(math.isfinite(value) for _, _, entry in records for value in entry.values()):
        return math.inf
    entries = [entry for _, _, entry in records if "loss" in entry]
    worst = 0.0
    for group, largest in LARGEST.items():
        sizes = [entry[f"norm_{group}"] / math.sqrt(entry["n_gaussians"] * counts[group]) for entry in entries]
        worst = max(worst, max(sizes) / largest)
    image, alpha, depth = result.render(problem().views)
    finite = all(bool(torch.isfinite(t).all()) for t in (image, alpha, depth))
    return worst if finite else math.inf


def _add(name: str) -> None:
    @PART.case(
        f"20,000 iterations at two electrons: {name}",
        bound=1,
        unit="of the largest sensible norm",
        backends=("numba",),
        slow=True,
    )
    def run(setting: Setting) -> float:
        return _largest_ratio(name)


for _name in EXPERIMENTS["demo"].methods:
    if not METHODS[chosen(_name).method].sees_clean:  # the wall has no noise-free pictures
        _add(_name)
