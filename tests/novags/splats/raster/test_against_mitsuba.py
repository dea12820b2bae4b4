"""An exported PLY in Mitsuba's ray tracer of Gaussians: an independent reader, camera, SH basis and compositor.

Its model (volprim_rf_basic) is not EWA: alpha is the 3D Gaussian's peak along the ray. For small Gaussians far away the
two agree up to the affine approximation, of relative order size / distance, and SH directions per ray. It knows no
dilation (eps2d = 0 here), cuts at `extent` sigmas, and stops at transmittance 0.01. It also counts some rays through
flat Gaussians twice (its step off a surface is 1e-4 long), so these ones are nearly round.
"""

import subprocess
import sys

import numpy as np
import pytest
import torch

from novags.splats import Gaussians, rasterize, write_ply

SIZE, FOCAL = 96, 140.0

TRACE = """
import sys
import numpy as np
from simscenes import activate
mi = activate()
import drjit as dr
from mitsuba import ScalarTransform4f as T
ply, out, size, fov = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "volprim_rf_basic", "max_depth": 256, "srgb_primitives": False},
    "sensor": {
        "type": "perspective", "fov": fov, "fov_axis": "x",
        "to_world": T().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
        "sampler": {"type": "independent", "sample_count": 1},
    },
    "cloud": {"type": "ellipsoids", "filename": ply, "extent": 3.6, "extent_adaptive_clamping": False},
})
# one ray through every pixel centre
y, x = np.divmod(np.arange(size * size), size)
sensor = scene.sensors()[0]
ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f((x + 0.5) / size, (y + 0.5) / size), mi.Point2f(0.5))
color, _, _, _ = scene.integrator().sample(
    mode=dr.ADMode.Primal, scene=scene, sampler=sensor.sampler(), ray=ray, δL=None, state_in=None,
    active=mi.Bool(True),
)
np.save(out, np.array(color).T.reshape(size, size, 3))
"""


def cloud(n: int) -> Gaussians:
    """Overlapping on the image, but apart along it: Mitsuba orders by entry points, EWA by centres."""
    g = torch.Generator().manual_seed(3)
    z = 3.0 * 1.12 ** torch.arange(n)
    means = torch.cat([0.4 * (torch.rand(n, 2, generator=g) - 0.5), torch.ones(n, 1)], 1) * z[:, None]
    return Gaussians(
        means=means,
        quats=torch.randn(n, 4, generator=g),
        log_scales=torch.log((0.015 + 0.015 * torch.rand(n, 3, generator=g)) * z[:, None]),
        logit_opacities=torch.randn(n, generator=g),
        sh=0.25 * torch.randn(n, 16, 3, generator=g),
    )


@pytest.mark.usefixtures("jit")  # its integrator of Gaussians has no scalar form
def test_a_ray_traced_ply_looks_like_the_splatted_one(tmp_path):
    gaussians = cloud(30)
    write_ply(tmp_path / "cloud.ply", gaussians)
    fov = 2 * np.degrees(np.arctan(0.5 * SIZE / FOCAL))
    files = [str(tmp_path / "cloud.ply"), str(tmp_path / "image.npy")]
    command = [sys.executable, "-c", TRACE, *files, str(SIZE), str(fov)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    traced = np.load(tmp_path / "image.npy")
    K = torch.tensor([[[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]]])
    image, alpha, _ = rasterize(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh, torch.eye(4)[None], K,
        SIZE, SIZE, sh_degree=3, eps2d=0.0,
    )  # fmt: skip
    splatted = image[0].numpy()
    error = np.abs(splatted - traced)
    assert splatted.max() > 0.5
    assert error.mean() < 2e-3
    assert np.quantile(error, 0.99) < 0.015
    assert np.corrcoef(splatted.ravel(), traced.ravel())[0, 1] > 0.999
