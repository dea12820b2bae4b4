"""Kernels compiled ahead are all that a first fit needs."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
COMPILED_LATER = """
import sys
import torch
from novags.splats import FitConfig, Gaussians, McmcConfig, Views, fit, rasterize
from novags.splats.warm import warm

def compiled():
    kernels = [value for name, module in list(sys.modules.items()) if name.startswith("novags.splats.cpu")
               for value in vars(module).values() if hasattr(value, "signatures")]
    return {(k.py_func.__module__, k.py_func.__name__, str(s)) for k in kernels for s in k.signatures}

warm()
before = compiled()
assert len(before) >= 8
start = Gaussians.from_points(torch.rand(900, 3), torch.rand(900, 3), sh_degree=3)
view = torch.eye(4)
view[2, 3] = 3.0
views = Views(view[None], torch.tensor([[[30.0, 0, 20], [0, 30, 20], [0, 0, 1]]]), 41, 37)
image = torch.rand(37, 41, 3)
config = FitConfig(iterations=8, sh_every=2, cap_max=950, mcmc=McmcConfig(refine_start=2, refine_every=2))
fit(start, views, lambda i: image, config)
fit(start, views, lambda i: image, config, extra_losses=[lambda step: step.depth.mean()], needs_depth=True)
g = start.requires_grad_()
for mode in ("RGB", "RGB+ED", "D"):
    for options in ({}, {"rasterize_mode": "antialiased", "eps2d": 0.1}):
        shape = g.means, g.quats, g.scales, g.opacities
        cameras = views.viewmats, views.Ks, 41, 37
        rasterize(*shape, g.sh, *cameras, sh_degree=3, render_mode=mode, **options)[0].sum().backward()
print(sorted(compiled() - before))
"""


def test_nothing_is_compiled_in_a_fit_after_the_kernels_were_warmed():
    """In a process of its own: other tests call kernels in ways of theirs."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", COMPILED_LATER], capture_output=True, text=True, cwd=ROOT, env=environment, check=False
    )
    assert (done.stdout.strip(), done.stderr.strip()) == ("[]", "")
