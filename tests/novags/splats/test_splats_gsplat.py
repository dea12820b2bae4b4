"""How a call is mapped onto gsplat's: the readable rasteriser, behind gsplat's signature, stands in for its kernels.

What the kernels themselves compute is compared in test_splats_cpu_against_reference, on a GPU.
"""

import inspect

import gsplat
import pytest
import torch

from novags.splats import raster_gsplat, raster_torch, rasterize

MODES = ["RGB", "D", "ED", "RGB+D", "RGB+ED"]


def as_float32(scene):
    return {k: v.float() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}


@pytest.fixture
def calls(monkeypatch):
    """Arguments of the calls to gsplat by name; CPU tensors pass for CUDA tensors."""
    seen = []

    def rasterization(*arguments, **options):
        call = inspect.signature(gsplat.rasterization).bind(*arguments, **options).arguments
        seen.append(call)
        mode = call["render_mode"]
        image, alpha, info = raster_torch.render(
            *(call[name] for name in ("means", "quats", "scales", "opacities", "colors")),
            call["viewmats"][0], call["Ks"][0], call["width"], call["height"],
            sh_degree=call["sh_degree"], near_plane=call["near_plane"], far_plane=call["far_plane"],
            eps2d=call["eps2d"], antialiased=call["rasterize_mode"] == "antialiased", radius_clip=call["radius_clip"],
            with_color=mode.startswith("RGB"), with_depth=mode.endswith("D"),
        )  # fmt: skip
        radii = info["radii"][:, None] * torch.tensor([2, 1]) // 2  # per axis, as since gsplat 1.5
        meta = {"means2d": info["means2d"].requires_grad_(), "depths": info["depths"], "radii": radii.int()}
        return image[None], alpha[None], {name: value[None] for name, value in meta.items()}

    monkeypatch.setattr(raster_gsplat, "rasterization", rasterization)
    monkeypatch.setattr(torch.Tensor, "is_cuda", True)
    return seen


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("sh_degree", [None, 2])
def test_images_and_info_are_those_of_the_reference(make_scene, calls, mode, sh_degree):
    scene = as_float32(make_scene(3, 60, 21, 18, sh_degree=sh_degree, cameras=2))
    background = torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    image, alpha, info = rasterize(**scene, backgrounds=background, render_mode=mode)
    expected, expected_alpha, expected_info = rasterize(
        **scene, backgrounds=background, render_mode=mode, backend="torch"
    )
    assert len(calls) == 2  # so "auto" means gsplat for CUDA tensors, camera by camera
    torch.testing.assert_close(image, expected)
    torch.testing.assert_close(alpha, expected_alpha)
    for name, value in expected_info.items():
        torch.testing.assert_close(info[name], value)
        assert not info[name].requires_grad


def test_every_argument_reaches_gsplat(make_scene, calls):
    scene = as_float32(make_scene(4, 20, 12, 10, sh_degree=1))
    rasterize(
        **scene, near_plane=0.5, far_plane=7.0, eps2d=0.1, radius_clip=1.5, render_mode="RGB+ED",
        rasterize_mode="antialiased", backend="gsplat",
    )  # fmt: skip
    (call,) = calls
    for name in ("means", "scales", "opacities", "colors", "viewmats", "Ks"):
        assert torch.equal(call.pop(name), scene[name])
    direction = torch.nn.functional.normalize
    torch.testing.assert_close(direction(call.pop("quats"), dim=-1), direction(scene["quats"], dim=-1))
    assert call == {
        "width": 12, "height": 10, "sh_degree": 1, "near_plane": 0.5, "far_plane": 7.0, "eps2d": 0.1,
        "radius_clip": 1.5, "render_mode": "RGB+D", "packed": False, "rasterize_mode": "antialiased",
    }  # fmt: skip


def test_one_radius_per_gaussian_of_older_versions_is_taken_as_it_is(make_scene, calls, monkeypatch):
    newer = raster_gsplat.rasterization

    def older(*arguments, **options):
        image, alpha, meta = newer(*arguments, **options)
        return image, alpha, {**meta, "radii": meta["radii"][..., 0]}

    scene = as_float32(make_scene(4, 20, 12, 10))
    expected = rasterize(**scene, backend="gsplat")[2]["radii"]
    monkeypatch.setattr(raster_gsplat, "rasterization", older)
    radii = rasterize(**scene, backend="gsplat")[2]["radii"]
    assert radii.shape == (1, 20)
    assert torch.equal(radii, expected)


def test_cpu_tensors_are_refused(make_scene):
    with pytest.raises(ValueError, match=r"needs float32 CUDA tensors, got torch.float32 on cpu.*backend='numba'"):
        rasterize(**as_float32(make_scene(0, 5, 8, 8)), backend="gsplat")


def test_float64_is_refused(make_scene, calls):
    with pytest.raises(ValueError, match="needs float32 CUDA tensors, got torch.float64"):
        rasterize(**make_scene(0, 5, 8, 8), backend="gsplat")
    assert not calls
