"""What makes no difference: the frame of the world, the order of Gaussians and views, the unit of light, a mirror."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor

from novags.cameras.align import Similarity, align, to_estimated
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.splats import rasterize
from novags.testbed.metrics.images import image_scores
from sensor_model import Exposure, Sensor, expose, mosaic, photons_for_electrons
from sensor_model.params import CFAS
from simscenes import orbit_rig

seeds = st.integers(0, 2**32 - 1)
BACKENDS = ("torch", "numba")
CAMERA = Sensor(gain=2.0, eta=0.5, mu_e_sat=1800.0, black_level=64, bits=12, sigma_d=1.5, cfa=None)
EXPOSURE = Exposure(time=0.02)


def scene(seed: int, count: int = 20) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(seed)
    return {
        "means": torch.randn(count, 3, generator=g) * 0.4,
        "quats": torch.randn(count, 4, generator=g),
        "scales": torch.rand(count, 3, generator=g) * 0.2 + 0.02,
        "opacities": torch.rand(count, generator=g) * 0.9 + 0.05,
        "colors": torch.rand(count, 3, generator=g),
    }


def views(count: int) -> dict[str, Tensor]:
    rig = orbit_rig(count, 20, 16, 50, radius=3.0)
    return {"viewmats": torch.tensor(rig.viewmats).float(), "Ks": torch.tensor(rig.Ks).float()}


def picture(gaussians: dict[str, Tensor], cameras: dict[str, Tensor], backend: str) -> Tensor:
    made, alpha, _ = rasterize(**gaussians, **cameras, width=20, height=16, render_mode="RGB+D", backend=backend)
    return torch.cat([made, alpha], -1).clone()


def product(a: Tensor, b: Tensor) -> Tensor:
    """Of quaternions wxyz."""
    w, x, y, z = a.unbind(-1)
    matrix = torch.stack([w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w]).reshape(4, 4)
    return b @ matrix.T


# A splat of opacity below 1/255 is left out and rays end at a transmittance of 1e-4: rounding may move either edge.
EDGES = 1 / 255


@pytest.mark.parametrize("backend", BACKENDS)
@settings(max_examples=6)
@given(seed=seeds)
def test_a_world_that_turns_with_its_cameras_looks_the_same(backend: str, seed: int) -> None:
    turn = Rotation.random(random_state=np.random.default_rng(seed))
    R, shift = torch.tensor(turn.as_matrix()).float(), torch.tensor([0.5, -1.0, 2.0])
    x, y, z, w = turn.as_quat()
    gaussians, cameras = scene(seed), views(2)
    moved = {**gaussians, "means": gaussians["means"] @ R.T + shift}
    moved["quats"] = product(torch.tensor([w, x, y, z]).float(), gaussians["quats"])
    viewmats = cameras["viewmats"].clone()
    viewmats[:, :3, :3] = cameras["viewmats"][:, :3, :3] @ R.T
    viewmats[:, :3, 3] -= (viewmats[:, :3, :3] @ shift[:, None])[..., 0]
    difference = (
        picture(moved, {**cameras, "viewmats": viewmats}, backend) - picture(gaussians, cameras, backend)
    ).abs()
    assert difference.max() < 4 * EDGES
    assert difference.mean() < 2e-5


@pytest.mark.parametrize("backend", BACKENDS)
@settings(max_examples=6)
@given(seed=seeds)
def test_the_order_of_gaussians_makes_no_difference(backend: str, seed: int) -> None:
    gaussians, cameras = scene(seed), views(2)
    order = torch.randperm(20, generator=torch.Generator().manual_seed(seed))
    shuffled = {name: tensor[order] for name, tensor in gaussians.items()}
    # Depths differ, so the order of blending is the same; only sums of gradients would be taken in another one.
    torch.testing.assert_close(
        picture(shuffled, cameras, backend), picture(gaussians, cameras, backend), atol=1e-6, rtol=0
    )


@pytest.mark.parametrize("backend", BACKENDS)
@settings(max_examples=6)
@given(seed=seeds)
def test_views_are_rendered_alike_alone_together_and_in_any_order(backend: str, seed: int) -> None:
    gaussians, cameras = scene(seed), views(4)
    order = torch.randperm(4, generator=torch.Generator().manual_seed(seed))
    together = picture(gaussians, cameras, backend)
    again = picture(gaussians, {name: tensor[order] for name, tensor in cameras.items()}, backend)
    alone = [
        picture(gaussians, {name: tensor[k : k + 1] for name, tensor in cameras.items()}, backend) for k in range(4)
    ]
    torch.testing.assert_close(again, together[order], atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.cat(alone), together, atol=1e-6, rtol=0)


@given(seed=seeds, scale=st.floats(1e-3, 1e3))
def test_errors_of_cameras_do_not_depend_on_the_frame_of_the_estimate(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    true = torch.tensor(orbit_rig(7, 20, 20, 50, radius=3.0).viewmats)
    wrong = true.clone()
    turns = Rotation.from_rotvec(0.02 * rng.standard_normal((7, 3))).as_matrix()
    wrong[:, :3] = torch.from_numpy(turns) @ wrong[:, :3]
    turn = torch.from_numpy(Rotation.random(random_state=rng).as_matrix())
    frame = Similarity(scale, turn, torch.from_numpy(rng.normal(0, 2, 3)))
    first, second = align(wrong, true), align(to_estimated(frame, wrong), true)
    torch.testing.assert_close(second.rotation_deg, first.rotation_deg, atol=1e-6, rtol=0)
    torch.testing.assert_close(second.centre_error, first.centre_error, atol=1e-8, rtol=0)
    assert torch.equal(second.inliers, first.inliers)


@given(seed=seeds, exponent=st.integers(-8, 8), electrons=st.floats(1e-3, 1e4))
def test_the_unit_of_light_makes_no_difference_and_electrons_scale_with_light(
    seed: int, exponent: int, electrons: float
) -> None:
    light = np.random.default_rng(seed).exponential(1.0, (4, 5, 3))
    camera = Sensor(gain=1, eta=0.3, mu_e_sat=1e9, black_level=0, bits=16, rgb_response=(0.5, 1, 0.7))
    photons = photons_for_electrons(light, electrons=electrons, mean_green=1.0, sensor=camera)
    unit = 10.0**exponent
    other = photons_for_electrons(light * unit, electrons=electrons, mean_green=unit, sensor=camera)
    np.testing.assert_allclose(other, photons, rtol=1e-14)
    twice = photons_for_electrons(2 * light, electrons=electrons, mean_green=1.0, sensor=camera)
    np.testing.assert_array_equal(twice, 2 * photons)
    np.testing.assert_allclose(photons[..., 1] * 0.3, light[..., 1] * electrons, rtol=1e-14)


@given(seed=seeds, rows=st.integers(0, 5), columns=st.integers(0, 5), chips=st.booleans())
def test_a_part_of_a_sensor_takes_its_part_of_the_frame(seed: int, rows: int, columns: int, chips: bool) -> None:
    light = np.random.default_rng(seed).exponential(30.0, (9, 11, 3) if chips else (9, 11))
    whole = expose(light, CAMERA, EXPOSURE, seed=seed, view=0)
    part = expose(light[rows:, columns:], CAMERA, Exposure(time=0.02, origin=(rows, columns)), seed=seed, view=0)
    np.testing.assert_array_equal(part.dn, whole.dn[rows:, columns:])


@given(seed=seeds, h=st.integers(2, 9), w=st.integers(2, 9), cfa=st.sampled_from(CFAS))
def test_a_mosaic_moved_by_one_pixel_is_that_of_the_next_pattern(seed: int, h: int, w: int, cfa: str) -> None:
    colours = np.random.default_rng(seed).random((h, w, 3))
    beside = cfa[1] + cfa[0] + cfa[3] + cfa[2]
    np.testing.assert_array_equal(mosaic(colours, cfa)[:, 1:], mosaic(colours[:, 1:], beside))  # type: ignore[arg-type]
    below = cfa[2:] + cfa[:2]
    np.testing.assert_array_equal(mosaic(colours, cfa)[1:], mosaic(colours[1:], below))  # type: ignore[arg-type]


@settings(max_examples=8)
@given(seed=seeds, axis=st.sampled_from([0, 1]))
def test_the_enhancement_of_a_mirror_image_is_the_mirror_image(seed: int, axis: int) -> None:
    dark = torch.rand(17, 23, 3, generator=torch.Generator().manual_seed(seed)) * 0.1
    there = enhance(dark.flip(axis), EnhanceConfig())[0].flip(axis)
    torch.testing.assert_close(there, enhance(dark, EnhanceConfig())[0], atol=2e-5, rtol=2e-5)


@settings(max_examples=4)
@given(seed=seeds)
def test_scores_of_mirrored_pictures_and_of_exchanged_colours_are_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    reference = rng.random((14, 15, 3)).astype(np.float32)
    image = np.clip(reference + 0.2 * rng.standard_normal(reference.shape), 0, 1).astype(np.float32)
    scores = image_scores(image, reference)
    mirrored = image_scores(image[:, ::-1], reference[:, ::-1])
    swapped = image_scores(image[..., ::-1], reference[..., ::-1])
    for name, value in scores.items():
        if value is not None:
            assert mirrored[name] == pytest.approx(value, rel=1e-4, abs=1e-5), name  # type: ignore[literal-required]
            if name not in ("flip", "delta_e"):  # which know what the colours are
                assert swapped[name] == pytest.approx(value, rel=1e-4, abs=1e-5), name  # type: ignore[literal-required]
