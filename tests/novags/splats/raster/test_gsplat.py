"""How a call is mapped onto gsplat's: the readable rasteriser, behind gsplat's signature, stands in for its kernels.

What the kernels themselves compute is compared in cpu/test_against_reference.py, on a GPU.
"""

import inspect

import gsplat
import pytest
import torch

from novags.splats import rasterize
from novags.splats.raster import raster_gsplat
from novags.splats.raster.gsplat_call import REFUSED

MODES = ["RGB", "D", "ED", "RGB+D", "RGB+ED"]


def as_float32(scene):
    return {k: v.float() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}


@pytest.fixture
def calls(monkeypatch):
    """Arguments of the calls to gsplat by name; CPU tensors pass for CUDA tensors."""
    seen = []

    def rasterization(*arguments, **options):
        call = inspect.signature(gsplat.rasterization).bind(*arguments, **options)
        call.apply_defaults()
        seen.append(dict(call.arguments))
        known = {name: value for name, value in call.arguments.items() if name not in REFUSED}
        return rasterize(**known, backend="torch")

    monkeypatch.setattr(raster_gsplat, "rasterization", rasterization)
    monkeypatch.setattr(torch.Tensor, "is_cuda", True)
    return seen


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("sh_degree", [None, 2])
@pytest.mark.parametrize("backgrounds", [[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], [0.1, 0.2, 0.3], None])
def test_images_and_info_are_those_of_the_reference(make_scene, calls, mode, sh_degree, backgrounds):
    scene = as_float32(make_scene(3, 60, 21, 18, sh_degree=sh_degree, cameras=2))
    options = {"backgrounds": None if backgrounds is None else torch.tensor(backgrounds), "render_mode": mode}
    image, alpha, info = rasterize(**scene, **options)
    expected, expected_alpha, expected_info = rasterize(**scene, **options, backend="torch")
    assert len(calls) == 1  # so "auto" means gsplat for CUDA tensors
    assert backgrounds is None or calls[0]["backgrounds"].shape == (2, 3)
    torch.testing.assert_close(image, expected)
    torch.testing.assert_close(alpha, expected_alpha)
    for name, value in expected_info.items():
        torch.testing.assert_close(info[name], value)


def test_every_argument_reaches_gsplat(make_scene, calls):
    scene = as_float32(make_scene(4, 20, 12, 10, sh_degree=1))
    options = {
        "near_plane": 0.5, "far_plane": 7.0, "eps2d": 0.1, "radius_clip": 1.5, "render_mode": "RGB+ED",
        "rasterize_mode": "antialiased", "packed": True, "sparse_grad": True, "absgrad": True, "channel_chunk": 8,
        "segmented": True,
    }  # fmt: skip
    scene["means"].requires_grad_()
    rasterize(**scene, **options, backend="gsplat")
    (call,) = calls
    for name in ("means", "scales", "opacities", "colors", "viewmats", "Ks"):
        assert torch.equal(call.pop(name), scene[name])
    direction = torch.nn.functional.normalize
    torch.testing.assert_close(direction(call.pop("quats"), dim=-1), direction(scene["quats"], dim=-1))
    expected = {"width": 12, "height": 10, "sh_degree": 1, **options}
    assert {name: call[name] for name in expected} == expected
    defaults = {name: p.default for name, p in inspect.signature(gsplat.rasterization).parameters.items()}
    rest = call.keys() - expected.keys()
    assert {name: call[name] for name in rest} == {name: defaults[name] for name in rest}


def test_covariances_reach_gsplat_as_they_are(make_scene, calls):
    scene = as_float32(make_scene(4, 20, 12, 10))
    covars = torch.diag_embed(scene["scales"].square()).requires_grad_()
    with torch.no_grad():  # the stand-in has no gradient for them
        rasterize(**{**scene, "quats": None, "scales": None}, covars=covars)
    assert calls[0]["covars"] is covars
    assert calls[0]["quats"] is calls[0]["scales"] is None


def test_cpu_tensors_are_refused(make_scene):
    with pytest.raises(ValueError, match=r"needs float32 CUDA tensors, got torch.float32 on cpu.*backend='numba'"):
        rasterize(**as_float32(make_scene(0, 5, 8, 8)), backend="gsplat")


def test_float64_is_refused(make_scene, calls):
    with pytest.raises(ValueError, match="needs float32 CUDA tensors, got torch.float64"):
        rasterize(**make_scene(0, 5, 8, 8), backend="gsplat")
    assert not calls
