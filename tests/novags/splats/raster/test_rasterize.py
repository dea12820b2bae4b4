"""The rasteriser's border: what it refuses, its edge cases, and that threads do not change a bit."""

import math
import re

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from novags.splats import rasterize

BACKENDS = ["torch", "numba"]


def as_float32(scene):
    return {k: v.float() if isinstance(v, torch.Tensor) else v for k, v in scene.items()}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors", "viewmats", "Ks"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_non_finite_value_is_refused_by_name_and_number(make_scene, backend, name, value):
    scene = as_float32(make_scene(0, 40, 16, 16))
    scene[name] = scene[name].clone()
    scene[name].reshape(-1)[:2] = value
    size = scene[name].numel()
    with pytest.raises(ValueError, match=f"{name} must be finite, got 2 non-finite of {size}"):
        rasterize(**scene, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_non_finite_sh_coefficient_is_refused(make_scene, backend):
    scene = as_float32(make_scene(0, 40, 16, 16, sh_degree=2))
    scene["colors"][7, 8, 1] = math.nan
    with pytest.raises(ValueError, match="colors must be finite, got 1 non-finite"):
        rasterize(**scene, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [("quats", 0.0, "must not be zero"), ("scales", -1.0, "must be >= 0"), ("opacities", 1.5, "must lie in 0..1")],
)
def test_values_out_of_range_are_refused_with_place_and_number(make_scene, backend, name, value, rule):
    scene = as_float32(make_scene(0, 40, 16, 16))
    scene[name][3] = value
    with pytest.raises(ValueError, match=rf"{name} {rule}, got .* at Gaussian 3 \(1 of 40\)"):
        rasterize(**scene, backend=backend)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"means": torch.zeros(39, 3)}, r"quats must have shape \[39, 4\], got \[40, 4\]"),
        ({"width": 0}, "at least 1 pixel"),
        ({"near_plane": 0.0}, "0 < near_plane < far_plane"),
        ({"eps2d": -1.0}, "eps2d must be finite and >= 0"),
        ({"sh_degree": 4}, "sh_degree must be 0, 1, 2, 3 or None"),
        ({"sh_degree": 1}, r"colors must be \[N=40, K >= 4, 3\]"),
        ({"render_mode": "rgb"}, "render_mode must be one of"),
        ({"backend": "cuda"}, "backend must be one of"),
        ({"backgrounds": torch.zeros(2)}, r"backgrounds must be \[3\] or \[1, 3\]"),
        ({"viewmats": torch.zeros(0, 4, 4), "Ks": torch.zeros(0, 3, 3)}, "at least one camera"),
        ({"opacities": torch.zeros(40, dtype=torch.float64)}, "share one float dtype"),
        ({"Ks": -torch.eye(3)[None]}, "positive focal lengths"),
        (
            {"Ks": torch.eye(3)[None] + torch.eye(3)[None].roll(1, 2)},
            r"fx, 0, cx\].*skew is not supported",
        ),
        ({"Ks": 2 * torch.eye(3)[None]}, r"Ks must be \[\[fx, 0, cx\]"),
        ({"width": 16.0}, "width must be an integer, got 16.0"),
        ({"height": "16"}, "height must be an integer, got '16'"),
        ({"sh_degree": 1.0}, "sh_degree must be 0, 1, 2, 3 or None"),
        ({"means": torch.tensor(1.0)}, r"means must have shape \[N, 3\], got \[\]"),
        ({"viewmats": torch.tensor(1.0)}, r"viewmats must have shape \[C, 4, 4\], got \[\]"),
        ({"backgrounds": torch.tensor([0, math.nan, 0])}, "backgrounds must be finite, got 1 non-finite of 3"),
        ({"backgrounds": torch.zeros(3, dtype=torch.float64)}, "backgrounds is torch.float64"),
    ],
)
@pytest.mark.parametrize("backend", ["auto", "torch"])
def test_wrong_arguments_are_refused(make_scene, change, message, backend):
    with pytest.raises(ValueError, match=message):
        rasterize(**{**as_float32(make_scene(0, 40, 16, 16)), "backend": backend, **change})


@pytest.mark.parametrize("backend", BACKENDS)
def test_colours_that_are_not_rendered_may_hold_anything(make_scene, backend):
    scene = as_float32(make_scene(0, 40, 16, 16, sh_degree=1))
    expected = rasterize(**scene, render_mode="RGB+D", backend=backend)[0]
    scene["colors"][:, 4:] = math.nan
    scene["colors"].requires_grad_()
    image = rasterize(**scene, render_mode="RGB+D", backend=backend)[0]
    assert torch.equal(image, expected)
    image.sum().backward()
    assert not scene["colors"].grad[:, 4:].any()
    scene["colors"] = torch.full_like(scene["colors"], math.nan)
    torch.testing.assert_close(rasterize(**scene, render_mode="D", backend=backend)[0], expected[..., 3:])


def test_the_cpu_kernels_refuse_float64_and_say_what_to_do(make_scene):
    with pytest.raises(ValueError, match=r"convert with \.float\(\)\.cpu\(\), or use backend='torch'"):
        rasterize(**make_scene(0, 5, 8, 8), backend="numba")


@pytest.mark.parametrize("length", [1e-42, 1e-25, 1e20, 3e38])
def test_quaternions_of_any_length_turn_alike(make_scene, length):
    scene = as_float32(make_scene(12, 60, 24, 20))
    unit = torch.nn.functional.normalize(scene["quats"], dim=-1)
    expected = rasterize(**{**scene, "quats": unit}, backend="numba")[0]
    factor = 0.5 * length if length > 1 else length
    quats = (unit.double() * factor).float().requires_grad_()
    tolerance = 1e-2 if length < 1e-38 else 1e-5  # a subnormal number has few digits
    for backend in BACKENDS:
        image = rasterize(**{**scene, "quats": quats}, backend=backend)[0]
        torch.testing.assert_close(image, expected, atol=tolerance, rtol=0)
        (gradient,) = torch.autograd.grad(image.sum(), quats)
        assert not gradient.isnan().any()


def test_quaternion_gradients_shrink_as_the_length_grows(make_scene):
    scene, gradients = as_float32(make_scene(12, 60, 24, 20)), []
    for factor in (1.0, 2.0**-80, 2.0**70):
        quats = (scene["quats"] * factor).requires_grad_()
        rasterize(**{**scene, "quats": quats}, backend="numba")[0].square().sum().backward()
        gradients.append(quats.grad.double() * factor)
    for other in gradients[1:]:
        torch.testing.assert_close(other, gradients[0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        ("means", 3, 3e38),
        ("means", 0, -2e38),
        ("scales", (5, 0), 1e24),
        ("scales", (5, 1), 1e19),
        ("scales", (0, 2), 3e38),
        ("colors", slice(40), 3e38),
        ("colors", slice(40), -3e38),
        ("Ks", (0, 0, 0), 1e25),
    ],
)
def test_finite_values_that_overflow_float32_are_refused_with_their_place(make_scene, name, place, value):
    scene = as_float32(make_scene(7, 40, 16, 16, sh_degree=2))
    scene["opacities"][:] = 0.9
    scene["means"][5] = 0
    scene[name][place] = value
    first = int(torch.nonzero(scene[name] == value)[0, 0])
    with pytest.raises(ValueError, match=rf"overflow float32.*{name} {re.escape(str(value))} at \[{first}"):
        rasterize(**scene, backend="numba")


@pytest.mark.parametrize(("place", "value"), [((3, 0), 1e38), ((3, 1), -1e37), ((3, 2), 1e30)])
def test_a_far_away_gaussian_that_does_not_overflow_changes_nothing(make_scene, place, value):
    scene = as_float32(make_scene(0, 40, 16, 16))
    scene["opacities"][3] = 0
    expected = rasterize(**scene, backend="numba")[0]
    scene["opacities"][3], scene["means"][place] = 1, value
    assert torch.equal(rasterize(**scene, backend="numba")[0], expected)


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e9, 1e10])
def test_a_gaussian_much_larger_than_the_image_covers_it_evenly(make_scene, scale):
    scene = make_scene(0, 3, 16, 16)
    scene["means"][0], scene["scales"][0], scene["opacities"][0] = 0, scale, 0.9
    image, alpha, _ = rasterize(**scene, backend="torch")
    inputs = {k: v.requires_grad_() for k, v in as_float32(scene).items() if k in ("means", "quats", "scales")}
    image32, alpha32, _ = rasterize(**{**as_float32(scene), **inputs}, backend="numba")
    torch.testing.assert_close(image32.double(), image, atol=1e-5, rtol=0)
    torch.testing.assert_close(alpha32.double(), alpha, atol=1e-5, rtol=0)
    for gradient in torch.autograd.grad(image32.sum(), list(inputs.values())):
        assert gradient.isfinite().all()


def test_a_gaussian_too_far_for_its_direction_is_refused(make_scene):
    """Beyond 1.8e19 its squared distance overflows, and its colour would be that of no direction."""
    scene = as_float32(make_scene(0, 1, 16, 16, sh_degree=1))
    scene["viewmats"] = torch.eye(4)[None]
    scene["Ks"] = torch.tensor([[[16.0, 0, 8], [0, 16, 8], [0, 0, 1]]])
    scene["opacities"][0] = 0.9
    scene["means"][0], scene["scales"][0] = torch.tensor([0, 0, 1e18]), 5e16
    wide = {k: v.double() if torch.is_tensor(v) else v for k, v in scene.items()}
    expected, *_ = rasterize(**wide, far_plane=1e25, backend="torch")
    assert expected.max() > 0.1
    torch.testing.assert_close(rasterize(**scene, far_plane=1e25)[0].double(), expected, atol=1e-5, rtol=0)
    scene["means"][0], scene["scales"][0] = torch.tensor([0, 0, 2e19]), 1e18
    with pytest.raises(ValueError, match="overflow float32"):
        rasterize(**scene, far_plane=1e25, backend="numba")


def test_a_gaussian_too_large_for_float32_and_off_centre_is_refused(make_scene):
    """Its slope over the image is no longer known; evenness would be a wrong picture."""
    scene = as_float32(make_scene(0, 1, 16, 16))
    scene["viewmats"] = torch.eye(4)[None]
    scene["Ks"] = torch.tensor([[[16.0, 0, 8], [0, 16, 8], [0, 0, 1]]])
    scene["means"][0], scene["scales"][0], scene["opacities"][0] = torch.tensor([1e9, 0.0, 1.0]), 1e9, 0.9
    with pytest.raises(ValueError, match="overflow float32"):
        rasterize(**scene, backend="numba")


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("mode", ["RGB", "D", "ED", "RGB+D", "RGB+ED"])
@pytest.mark.parametrize("sh_degree", [None, 0, 3])
def test_no_gaussians_give_the_background_and_empty_gradients(make_scene, backend, mode, sh_degree):
    scene = as_float32(make_scene(0, 0, 9, 5, sh_degree=sh_degree))
    scene["means"].requires_grad_()
    scene["colors"].requires_grad_()
    background = torch.tensor([0.1, 0.2, 0.3])
    image, alpha, info = rasterize(**scene, backgrounds=background, render_mode=mode, backend=backend)
    n_color = 3 if mode.startswith("RGB") else 0
    assert image.shape == (1, 5, 9, n_color + mode.endswith("D"))
    assert info["radii"].shape == (0, 2)
    torch.testing.assert_close(image[..., :n_color], background[:n_color].expand(1, 5, 9, n_color))
    assert not image[..., n_color:].any()
    assert not alpha.any()
    image.sum().backward()
    for name in ("means", "colors"):
        assert scene[name].grad is None or scene[name].grad.shape == scene[name].shape


@pytest.mark.parametrize("backend", BACKENDS)
def test_render_modes_are_parts_of_each_other(make_scene, backend):
    scene = as_float32(make_scene(3, 60, 21, 18, sh_degree=1))
    images = {m: rasterize(**scene, render_mode=m, backend=backend)[0] for m in ("RGB", "D", "ED", "RGB+D", "RGB+ED")}
    alpha = rasterize(**scene, backend=backend)[1]
    torch.testing.assert_close(images["RGB+D"], torch.cat([images["RGB"], images["D"]], -1))
    torch.testing.assert_close(images["RGB+ED"], torch.cat([images["RGB"], images["ED"]], -1))
    torch.testing.assert_close(images["ED"] * alpha, images["D"])


@pytest.mark.parametrize("n_features", [1, 4, 5, 11])
def test_any_number_of_feature_channels_matches_the_reference(make_scene, n_features):
    scene = make_scene(4, 90, 30, 22)
    g = torch.Generator().manual_seed(2)
    scene["colors"] = torch.randn(90, n_features, generator=g, dtype=torch.float64).float().double()
    weights = torch.randn(1, 22, 30, n_features + 1, generator=g, dtype=torch.float64)
    results = []
    for backend, dtype in (("torch", torch.float64), ("numba", torch.float32)):
        arguments = {k: v.clone().to(dtype) if isinstance(v, torch.Tensor) else v for k, v in scene.items()}
        arguments["means"].requires_grad_()
        arguments["colors"].requires_grad_()
        image, _, _ = rasterize(**arguments, render_mode="RGB+D", backend=backend)
        (image * weights.to(dtype)).sum().backward()
        results.append((image.detach().double(), arguments["means"].grad.double(), arguments["colors"].grad.double()))
    for got, expected in zip(*results[::-1], strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_auto_means_the_cpu_kernels_for_cpu_tensors(make_scene):
    scene = as_float32(make_scene(9, 60, 20, 20))
    automatic, kernels, reference = (rasterize(**scene, backend=b)[0] for b in ("auto", "numba", "torch"))
    assert torch.equal(automatic, kernels)
    assert not torch.equal(automatic, reference)


def test_gradients_are_sparse_over_what_any_of_several_views_sees(make_scene):
    """Each of two views sees Gaussians that the other does not see."""
    scene = as_float32(make_scene(44, 200, 18, 16, cameras=2))
    scene["viewmats"][:, 0, 3] += torch.tensor([2.0, -2.0])
    scene["means"].requires_grad_()
    image, _, info = rasterize(**scene, sparse_grad=True)
    image.sum().backward()
    seen = [set(info["gaussian_ids"][info["camera_ids"] == c].tolist()) for c in range(2)]
    assert seen[0] - seen[1]
    assert seen[1] - seen[0]
    assert set(scene["means"].grad.coalesce().indices()[0].tolist()) == seen[0] | seen[1]


def test_info_tells_where_and_how_large(make_scene):
    scene = make_scene(6, 80, 24, 24, cameras=2)
    _, _, expected = rasterize(**scene, packed=False, backend="torch")
    _, _, info = rasterize(**as_float32(scene), packed=False, backend="numba")
    assert info["radii"].dtype == torch.int32
    assert info["means2d"].shape == (2, 80, 2)
    torch.testing.assert_close(info["radii"], expected["radii"], atol=1, rtol=0)
    torch.testing.assert_close(info["means2d"].double(), expected["means2d"], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(info["depths"].double(), expected["depths"], atol=1e-5, rtol=1e-5)
    assert not info["means2d"].requires_grad


def test_images_and_gradients_have_the_same_bits_for_any_number_of_threads(make_scene):
    results = []
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            scene = as_float32(make_scene(7, 20_000, 130, 70, sh_degree=2))
            names = ["means", "quats", "scales", "opacities", "colors", "viewmats"]
            for name in names:
                scene[name].requires_grad_()
            image, alpha, _ = rasterize(**scene, render_mode="RGB+D", backend="numba")
            (image.square().sum() + alpha.sum()).backward()
            results.append([image, alpha, *(scene[name].grad for name in names)])
    finally:
        torch.set_num_threads(before)
    for others in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], others, strict=True))


def test_a_graph_can_be_walked_twice_and_two_graphs_at_once(make_scene):
    scene = as_float32(make_scene(8, 50, 20, 20))
    scene["means"].requires_grad_()
    first = rasterize(**scene)[0].square().sum()
    second = rasterize(**scene)[0].sum()  # renders into other memory while the first graph is alive
    (once,) = torch.autograd.grad(first, scene["means"], retain_graph=True)
    (other,) = torch.autograd.grad(second, scene["means"])
    (again,) = torch.autograd.grad(first, scene["means"])
    assert torch.equal(once, again)
    assert not torch.equal(once, other)


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "means2d"])
def test_what_changes_between_forward_and_backward_is_noticed(make_scene, name):
    scene = as_float32(make_scene(8, 50, 20, 20))
    scene["means"].requires_grad_()
    image, _, info = rasterize(**scene, packed=False, backend="numba")
    with torch.no_grad():
        (info if name == "means2d" else scene)[name].mul_(1.5)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def test_a_second_derivative_is_refused_not_left_out(make_scene):
    scene = as_float32(make_scene(8, 50, 20, 20))
    scene["means"].requires_grad_()
    image, _, _ = rasterize(**scene, backend="numba")
    for loss in (image.sum(), image.square().sum()):
        with pytest.raises(RuntimeError, match=r"no second derivative.*backend='torch'"):
            torch.autograd.grad(loss, scene["means"], create_graph=True)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10_000), st.floats(0.1, 10.0))
def test_colors_scale_and_alpha_stays_between_zero_and_one(width, height, seed, factor):
    g = torch.Generator().manual_seed(seed)
    n = int(torch.randint(1, 60, (1,), generator=g))
    K = torch.tensor([[[20.0, 0, width / 2], [0, 20.0, height / 2], [0, 0, 1]]])
    view = torch.eye(4)[None].clone()
    view[0, 2, 3] = 2.0
    shape = (torch.randn(n, 3, generator=g), torch.randn(n, 4, generator=g), torch.rand(n, 3, generator=g))
    opacities, colors = torch.rand(n, generator=g), torch.rand(n, 3, generator=g)
    image, alpha, _ = rasterize(*shape, opacities, colors, view, K, width, height)
    scaled, _, _ = rasterize(*shape, opacities, factor * colors, view, K, width, height)
    torch.testing.assert_close(scaled, factor * image, rtol=1e-5, atol=1e-5)
    assert alpha.min() >= 0
    assert alpha.max() <= 1 - 1e-4 * (1 - 1e-3)
    assert (image <= alpha + 1e-5).all()  # colours are at most 1, so a pixel is at most its alpha
