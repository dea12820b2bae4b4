"""`rasterize` as the call of gsplat: its arguments, its info, and a script written for it with the import changed."""

import inspect
import math
from types import SimpleNamespace

import gsplat
import pytest
import torch
from torch import Tensor

from novags.splats import rasterize
from novags.splats.raster.gsplat_call import REFUSED

CPU = ["numba", "torch"]


def as_float32(scene):
    return {k: v.float() if isinstance(v, Tensor) else v for k, v in scene.items()}


def train(rasterization, scene, target, *, steps=9, packed=False, sparse_grad=False, absgrad=False, **options):
    """A trainer as users of gsplat write them: cameras, Adam, and the statistics of adaptive densification."""
    splats = torch.nn.ParameterDict({
        "means": scene["means"].clone(), "quats": scene["quats"].clone(), "scales": scene["scales"].log(),
        "opacities": scene["opacities"].clamp(0.05, 0.95).logit(), "sh0": scene["colors"][:, :1].clone(),
        "shN": scene["colors"][:, 1:].clone(),
    })  # fmt: skip
    optimizer = torch.optim.Adam(splats.parameters(), lr=0.01)
    if sparse_grad:
        optimizer = torch.optim.SparseAdam(list(splats.parameters()), lr=0.01)
    state = {"grad2d": torch.zeros(len(splats["means"])), "count": torch.zeros(len(splats["means"]))}
    losses = []
    camtoworlds = torch.linalg.inv(scene["viewmats"])
    for step in range(steps):
        pick = step % len(camtoworlds)
        renders, alphas, info = rasterization(
            means=splats["means"], quats=splats["quats"], scales=torch.exp(splats["scales"]),
            opacities=torch.sigmoid(splats["opacities"]), colors=torch.cat([splats["sh0"], splats["shN"]], 1),
            viewmats=torch.linalg.inv(camtoworlds[pick : pick + 1]), Ks=scene["Ks"][pick : pick + 1],
            width=scene["width"], height=scene["height"], packed=packed, absgrad=absgrad, sparse_grad=sparse_grad,
            rasterize_mode="antialiased", distributed=False, camera_model="pinhole", with_ut=False, with_eval3d=False,
            sh_degree=2, near_plane=0.01, far_plane=1e10, render_mode="RGB+ED", **options,
        )  # fmt: skip
        colors, depths = renders[..., 0:3], renders[..., 3:4]
        colors = colors + torch.tensor([[0.1, 0.2, 0.3]]) * (1.0 - alphas)
        info["means2d"].retain_grad()
        loss = (colors - target[pick : pick + 1]).abs().mean() + 1e-3 * (1 / (1 + depths)).mean()
        loss.backward()
        losses.append(loss.item())
        accumulate(state, info, packed=packed, absgrad=absgrad)
        if sparse_grad:
            for name in splats:
                if not splats[name].grad.is_sparse:
                    ids = info["gaussian_ids"]
                    splats[name].grad = torch.sparse_coo_tensor(
                        ids[None], splats[name].grad[ids], splats[name].shape, check_invariants=False
                    )
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
    return SimpleNamespace(losses=losses, splats=splats, state=state)


def accumulate(state, info, *, packed, absgrad):
    """Screen-space gradients of visible Gaussians, in halves of the image, summed over views."""
    for key in ("width", "height", "n_cameras", "radii", "gaussian_ids", "means2d"):
        assert key in info
    gradients = (info["means2d"].absgrad if absgrad else info["means2d"].grad).clone()
    gradients[..., 0] *= info["width"] / 2.0 * info["n_cameras"]
    gradients[..., 1] *= info["height"] / 2.0 * info["n_cameras"]
    if packed:
        ids = info["gaussian_ids"]
    else:
        seen = (info["radii"] > 0.0).all(dim=-1)
        ids, gradients = torch.where(seen)[1], gradients[seen]
    state["grad2d"].index_add_(0, ids, gradients.norm(dim=-1))
    state["count"].index_add_(0, ids, torch.ones_like(ids, dtype=torch.float32))


@pytest.fixture
def scene(make_scene):
    return as_float32(make_scene(21, 30, 16, 12, sh_degree=2, cameras=3))


@pytest.fixture
def target(make_scene):
    return rasterize(**as_float32(make_scene(22, 30, 16, 12, sh_degree=0, cameras=3)))[0].detach()


@pytest.mark.parametrize("options", [{}, {"absgrad": True, "packed": True}, {"packed": True, "sparse_grad": True}])
def test_a_trainer_written_for_gsplat_runs_and_gets_what_the_reference_gets(scene, target, options):
    kernels = train(rasterize, scene, target, **options)
    reference = train(lambda **call: rasterize(**call, backend="torch"), scene, target, **options)
    assert kernels.losses[6] < kernels.losses[0]
    assert kernels.losses == pytest.approx(reference.losses, rel=2e-3)
    assert torch.equal(kernels.state["count"], reference.state["count"])
    assert kernels.state["count"].max() == 9
    # Adam turns the sign of a gradient that is almost nothing into a step: few Gaussians may drift apart
    error = (kernels.state["grad2d"] - reference.state["grad2d"]).abs() / reference.state["grad2d"].clamp_min(1e-6)
    assert torch.quantile(error, 0.9) < 0.01


def test_the_names_order_and_defaults_are_those_of_gsplat():
    ours, theirs = (inspect.signature(f).parameters for f in (rasterize, gsplat.rasterization))
    named = [name for name, p in ours.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert named == list(theirs)[: len(named)]
    assert set(theirs) <= {*named, *REFUSED}
    for name in named:
        ignored = {"tile_size"}  # None since 1.6, which is 16
        assert name in ignored or ours[name].default == theirs[name].default, name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distributed": True}, "distributed=True is not supported by rasterize: one process"),
        ({"camera_model": "fisheye"}, "camera_model='fisheye' is not supported.*pinholes"),
        ({"camera_model": "ortho"}, "camera_model='ortho' is not supported"),
        ({"with_ut": True}, "with_ut=True is not supported"),
        ({"with_eval3d": True}, "with_eval3d=True is not supported"),
        ({"radial_coeffs": torch.zeros(1, 6)}, "radial_coeffs=.*undistort the pictures first"),
        ({"rolling_shutter": SimpleNamespace(name="ROLLING_TOP_TO_BOTTOM")}, "rolling_shutter=.*not supported"),
        ({"viewmats_rs": torch.eye(4)[None]}, "viewmats_rs=.*not supported"),
        ({"global_z_order": False}, "global_z_order=False is not supported.*camera z"),
        ({"extra_signals": torch.zeros(30, 2)}, "extra_signals=.*colors"),
        ({"tile_size": 8}, "tile_size=8 is not supported.*16"),
        ({"channel_chunk": 0}, "channel_chunk must be at least 1, got 0"),
        ({"render_mode": "RGB-Ed"}, "render_mode='RGB-Ed' is not supported"),
        ({"rasterize_mode": "smooth"}, "rasterize_mode must be one of"),
        ({"sparse_grad": True, "packed": False}, "sparse_grad=True needs packed=True"),
        ({"quats": None}, "quats must be given, or covars"),
        ({"covars": torch.eye(3).repeat(30, 1, 1).requires_grad_()}, "covars must not require a gradient on the CPU"),
        ({"covars": -torch.eye(3).repeat(30, 1, 1)}, "covars must be symmetric and positive semi-definite.*Gaussian 0"),
    ],
)
@pytest.mark.parametrize("backend", CPU)
def test_what_cannot_be_done_is_refused_by_name_with_the_reason(scene, change, message, backend):
    with pytest.raises(ValueError, match=message):
        rasterize(**{**scene, "backend": backend, **change})


def test_names_that_nobody_knows_are_a_type_error(scene):
    with pytest.raises(TypeError, match="unexpected keyword argument 'background'"):
        rasterize(**scene, background=torch.zeros(3))


@pytest.mark.parametrize("backend", CPU)
def test_defaults_and_settings_without_effect_pass_and_change_nothing(scene, backend):
    shutter = gsplat.RollingShutterType.GLOBAL
    refused = dict.fromkeys(REFUSED) | {"distributed": False, "global_z_order": True, "rolling_shutter": shutter}
    expected = rasterize(**scene, backend=backend)[0]
    settings = {"segmented": True, "channel_chunk": 1, "tile_size": 16, "packed": False, "with_ut": False}
    assert torch.equal(rasterize(**scene, **{**refused, **settings}, backend=backend)[0], expected)


@pytest.mark.parametrize("backend", CPU)
def test_arguments_may_be_given_by_place(scene, backend):
    tensors = [scene[name] for name in ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")]
    image = rasterize(*tensors, 16, 12, 2.0, 4.0, 1.0, 0.1, 1, backend=backend)[0]
    named = {"near_plane": 2.0, "far_plane": 4.0, "radius_clip": 1.0, "eps2d": 0.1, "sh_degree": 1}
    assert torch.equal(image, rasterize(**{**scene, **named}, backend=backend)[0])
    assert not torch.equal(image, rasterize(**scene, backend=backend)[0])


@pytest.mark.parametrize("backend", CPU)
def test_covariances_render_as_the_rotations_and_scales_they_are_made_of(make_scene, backend):
    scene = as_float32(make_scene(31, 60, 24, 20))
    rotation = gsplat.utils.normalized_quat_to_rotmat(torch.nn.functional.normalize(scene["quats"].double(), dim=-1))
    axes = rotation * scene["scales"].double()[:, None]
    covars = (axes @ axes.mT).float()
    image = rasterize(**{**scene, "quats": None, "scales": None}, covars=covars, backend=backend)[0]
    torch.testing.assert_close(image, rasterize(**scene, backend=backend)[0], atol=2e-3, rtol=0)


@pytest.mark.parametrize("backend", CPU)
@pytest.mark.parametrize("sh_degree", [None, 1])
def test_every_camera_may_have_colours_of_its_own(make_scene, backend, sh_degree):
    scene = as_float32(make_scene(32, 50, 20, 18, sh_degree=sh_degree, cameras=2))
    colors = torch.stack([scene["colors"], scene["colors"].flip(0)]).requires_grad_()
    image = rasterize(**{**scene, "colors": colors}, backend=backend)[0]
    for i in range(2):
        one = {**scene, "colors": colors[i], "viewmats": scene["viewmats"][i : i + 1], "Ks": scene["Ks"][i : i + 1]}
        assert torch.equal(image[i], rasterize(**one, backend=backend)[0][0])
    with pytest.raises(ValueError, match=r"colors must be one for all or \[C=2, N, \.\.\.\]"):
        rasterize(**{**scene, "colors": colors[:1]}, backend=backend)


def gradients_pixel_by_pixel(scene, weights, mode):
    """dL/d means2d [C, N, 2] and the sums of their absolute values, by one backward pass of the reference a pixel."""
    total, absolute = 0.0, 0.0
    for y in range(scene["height"]):
        for x in range(scene["width"]):
            image, alpha, info = rasterize(**scene, render_mode=mode, packed=False, backend="torch")
            info["means2d"].retain_grad()
            of_pixel = (image * weights[..., :-1])[:, y, x].sum() + (alpha * weights[..., -1:])[:, y, x].sum()
            of_pixel.backward()
            total, absolute = total + info["means2d"].grad, absolute + info["means2d"].grad.abs()
    return total, absolute


@pytest.mark.parametrize(("channels", "mode"), [(3, "RGB"), (6, "RGB+D")])
def test_gradients_of_the_centres_are_those_of_every_pixel_added_up(make_scene, channels, mode):
    scene = make_scene(41, 8, 5, 4, cameras=2)
    g = torch.Generator().manual_seed(0)
    scene["colors"] = torch.rand(8, channels, generator=g, dtype=torch.float64)
    scene["means"].requires_grad_()
    n = channels + (mode == "RGB+D") + 1
    weights = torch.randn(2, 4, 5, n, generator=g, dtype=torch.float64)
    total, absolute = gradients_pixel_by_pixel(scene, weights, mode)
    assert (absolute > 1.2 * total.abs()).any()
    for backend, packed in (("torch", False), ("torch", True), ("numba", False), ("numba", True)):
        given = scene if backend == "torch" else as_float32(scene)
        image, alpha, info = rasterize(**given, render_mode=mode, packed=packed, absgrad=True, backend=backend)
        info["means2d"].retain_grad()
        ((image * weights[..., :-1]).sum() + (alpha * weights[..., -1:]).sum()).backward()
        rows = (info["camera_ids"], info["gaussian_ids"]) if packed else (slice(None), slice(None))
        tolerance = 1e-9 if backend == "torch" else 1e-3
        for found, expected in ((info["means2d"].grad, total), (info["means2d"].absgrad, absolute)):
            torch.testing.assert_close(found.double(), expected[rows], rtol=tolerance, atol=tolerance)
        with pytest.raises(KeyError, match="isect_ids is not provided: the tile lists"):
            info["isect_ids"]


def test_centres_move_the_image_as_their_gradient_says(make_scene):
    """Without the reference: a camera's principal point moves all centres at once."""
    scene = make_scene(42, 30, 16, 14)
    scene["means"].requires_grad_()
    weights = torch.randn(14, 16, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    image, _, info = rasterize(**as_float32(scene), packed=False)
    info["means2d"].retain_grad()
    (image[0] * weights).sum().backward()
    step, expected = 1e-5, []
    for axis in (0, 1):
        ends = []
        for sign in (-1, 1):
            Ks = scene["Ks"].clone()
            Ks[0, axis, 2] += sign * step
            with torch.no_grad():
                ends.append(float((rasterize(**{**scene, "Ks": Ks}, backend="torch")[0][0] * weights).sum()))
        expected.append((ends[1] - ends[0]) / (2 * step))
    found = info["means2d"].grad[0].sum(0)
    # the limits of the affine approximation move with the principal point, which few Gaussians notice
    torch.testing.assert_close(found.double(), torch.tensor(expected, dtype=torch.float64), rtol=2e-2, atol=2e-2)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_info_has_the_numbers_of_the_reference_packed_or_not(make_scene, mode):
    scene = make_scene(43, 60, 24, 20, cameras=2)
    scene["means"][:20] += scene["viewmats"][0, 2, :3] * -8  # behind the first camera
    _, _, expected = rasterize(**scene, rasterize_mode=mode, packed=False, backend="torch")
    _, _, full = rasterize(**as_float32(scene), rasterize_mode=mode, packed=False)
    _, _, rows = rasterize(**as_float32(scene), rasterize_mode=mode)
    seen = expected["radii"].amax(-1) > 0
    assert 20 < int(seen.sum()) < 110
    assert torch.equal(torch.stack([rows["camera_ids"], rows["gaussian_ids"]], 1), torch.nonzero(seen))
    assert full["camera_ids"] is full["gaussian_ids"] is None
    for name in ("means2d", "depths", "conics", "opacities", "radii"):
        tolerance = {"atol": 1.0, "rtol": 0} if name == "radii" else {"atol": 1e-3, "rtol": 1e-3}
        torch.testing.assert_close(full[name][seen].double(), expected[name][seen].double(), **tolerance)
        torch.testing.assert_close(rows[name], full[name][seen])
    reach = torch.sqrt(2 * torch.log(255 * expected["opacities"][seen]))
    covs = torch.linalg.inv(expected["conics"][seen][:, (0, 1, 1, 2)].reshape(-1, 2, 2))
    radii = torch.ceil(reach[:, None] * torch.diagonal(covs, dim1=1, dim2=2).sqrt()).clamp_min(1)
    torch.testing.assert_close(expected["radii"][seen].double(), radii, atol=1.0, rtol=0)
    sizes = [
        full[name] for name in ("width", "height", "n_cameras", "n_batches", "tile_size", "tile_width", "tile_height")
    ]
    assert sizes == [24, 20, 2, 1, 16, 2, 2]


def test_sparse_gradients_are_the_dense_ones_of_what_is_visible(make_scene):
    scene = as_float32(make_scene(44, 200, 18, 16, cameras=2))
    scene["means"][:50, 0] += 30
    scene["viewmats"][0, 0, 3] += 3.0  # to the side, where it sees fewer than the second
    found = []
    for sparse in (False, True):
        leaves = {name: scene[name].clone().requires_grad_() for name in ("means", "quats", "scales", "opacities")}
        image, _, info = rasterize(**{**scene, **leaves}, sparse_grad=sparse)
        image.square().sum().backward()
        found.append({name: leaf.grad for name, leaf in leaves.items()})
    dense, sparse = found
    assert [sparse[name].is_sparse for name in sparse] == [True, True, True, False]
    for name in ("means", "quats", "scales"):
        assert torch.equal(sparse[name].to_dense(), dense[name])
        assert torch.equal(sparse[name].coalesce().indices()[0], torch.unique(info["gaussian_ids"]))
    assert len(sparse["means"].coalesce().values()) < 155
    seen = [set(info["gaussian_ids"][info["camera_ids"] == c].tolist()) for c in range(2)]
    assert seen[1] - seen[0]


def test_a_loss_of_the_centres_themselves_is_refused_on_the_kernels_and_right_on_the_reference(make_scene):
    scene = make_scene(45, 20, 12, 10)
    scene["means"].requires_grad_()
    with pytest.raises(RuntimeError, match="use rasterize.*backend='torch'"):
        rasterize(**as_float32(scene))[2]["means2d"].sum().backward()
    rasterize(**scene, backend="torch")[2]["means2d"][:, 0].sum().backward()
    view, K = scene["viewmats"][0], scene["Ks"][0]
    means = scene["means"].detach().requires_grad_()
    camera = means @ view[:3, :3].T + view[:3, 3]
    seen = rasterize(**{**scene, "means": means.detach()}, backend="torch")[2]["gaussian_ids"]
    (K[0, 0] * camera[:, 0] / camera[:, 2] + K[0, 2])[seen].sum().backward()
    torch.testing.assert_close(scene["means"].grad, means.grad)
    assert math.isfinite(float(means.grad.sum()))
