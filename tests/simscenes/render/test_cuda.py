"""On a GPU the same light is seen as on the CPU."""

import numpy as np
import pytest

from simscenes import default_rig
from simscenes.backend import backend_status, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.radiance import RenderedView, RenderMethod

WORKS = backend_status("cuda_ad")[0] and backend_status("llvm_ad")[0]


# Comparing two backends takes both, and few machines have a GPU; the CPU's own correctness is tested everywhere else.
@pytest.mark.gpu
@pytest.mark.skipif(not WORKS, reason="needs both the cuda_ad and the llvm_ad variant")
@pytest.mark.parametrize("target", [None, 0.05], ids=["even", "uneven"])
def test_cuda_renders_tabletop_like_llvm(target: float | None) -> None:
    rig, results = default_rig("tabletop", 3, 48, 48), []
    for variant in ("llvm_ad", "cuda_ad"):
        with using_variant(variant) as mi:
            loaded = build_scene("tabletop", mi)
            integrator = mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 2})
            view = RenderedView(RenderMethod(mi, mi.variant(), loaded, integrator), rig, 1)
            results.append(view.render(256 if target is None else None, target))
    a, b = (r.mean.astype(np.float64) for r in results)
    va, vb = (r.variance.astype(np.float64) for r in results)
    error = np.sqrt(3 * (va + vb).sum()) / a.size  # the channels of a pixel err together
    assert abs((a - b).mean()) < 5 * error
    blocks = [x.mean(-1).reshape(6, 8, 6, 8).mean((1, 3)) for x in (a, b, va, vb)]
    errors = np.sqrt((blocks[2] + blocks[3]) / 64)
    assert (np.abs(blocks[0] - blocks[1]) < 5 * errors + 5 * np.median(errors)).all()
