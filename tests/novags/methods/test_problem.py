"""What a method may see, what it gives back, and the Gaussians it starts from."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from novags.methods.enhanced.config import ORIGINAL_FIT, ORIGINAL_SCALE, EnhancedFitConfig
from novags.methods.enhanced.gaussian_fit import fit_for
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem, RawPictures, stacked
from novags.methods.reconstruction import Reconstruction
from novags.methods.start import brightened, start_gaussians
from novags.splats import FitConfig, Gaussians, Views, rasterize


def views(count: int = 2, width: int = 6, height: int = 4) -> Views:
    viewmats = torch.eye(4).repeat(count, 1, 1)
    viewmats[:, 2, 3] = 3
    K = torch.tensor([[6.0, 0, width / 2], [0, 6.0, height / 2], [0, 0, 1]])
    return Views(viewmats, K.repeat(count, 1, 1), width, height)


def problem(**changes) -> Problem:
    start = SimpleNamespace(points=torch.zeros(1, 3), colors=torch.zeros(1, 3), extent=2.5)
    values = {"views": views(), "srgb8": torch.rand(2, 4, 6, 3), "start": start, "seed": 7}
    return Problem(**{**values, **changes})


def test_sixteen_bit_pictures_are_clipped_and_encoded():
    linear = torch.tensor([-0.1, 0.0, 0.001, 0.2, 1.0, 1.3]).reshape(1, 1, 2, 3)
    inputs = problem(views=views(1, 2, 1), srgb8=torch.zeros(1, 1, 2, 3), linear16=linear)
    expected = [0, 0, 12.92 * 0.001, 1.055 * 0.2 ** (1 / 2.4) - 0.055, 1, 1]
    found = inputs.encoded("16bit")
    assert found.dtype == torch.float32
    np.testing.assert_allclose(found.flatten(), expected, rtol=1e-5)
    assert inputs.encoded("8bit") is inputs.srgb8


def test_pictures_of_another_name_are_refused():
    """Rationale: "8-bit" meant the 16-bit ones."""
    with pytest.raises(ValueError, match="pictures must be one of 8bit, 16bit, got '8-bit'"):
        problem(linear16=torch.rand(2, 4, 6, 3)).encoded("8-bit")


def test_sixteen_bit_pictures_must_be_there_to_be_used():
    with pytest.raises(ValueError, match="16-bit linear pictures"):
        problem().encoded("16bit")


@pytest.mark.parametrize("name", ["srgb8", "linear16", "clean"])
def test_pictures_of_another_size_than_the_cameras_are_refused(name):
    with pytest.raises(ValueError, match=name):
        problem(**{name: torch.zeros(2, 6, 4, 3)})


def test_views_are_numbered_unless_they_have_names_of_their_own():
    assert problem().names == ("0000", "0001")
    assert problem(names=("a", "b")).names == ("a", "b")
    with pytest.raises(ValueError, match="got 1 for 2 views"):
        problem(names=("a",))


def test_results_are_shared_by_key():
    inputs = problem()
    assert [inputs.once("a", lambda: 1), inputs.once("a", lambda: 2), inputs.once("b", lambda: 3)] == [1, 1, 3]


def test_a_problem_stays_itself_on_its_own_device():
    inputs = problem()
    assert inputs.to("cpu") is inputs


def test_on_another_device_all_pictures_and_cameras_are_there_and_nothing_is_shared():
    dn = torch.zeros(2, 4, 6)
    inputs = problem(
        linear16=torch.zeros(2, 4, 6, 3), clean=torch.zeros(2, 4, 6, 3),
        clean_demosaiced=torch.zeros(2, 4, 6, 3), raw=RawPictures(dn=dn, cfa="RGGB", black=64.0, white=1023.0),
    )  # fmt: skip
    inputs.once("a", lambda: 1)
    moved = inputs.to("meta")
    pictures = (moved.srgb8, moved.linear16, moved.clean, moved.clean_demosaiced)
    for tensor in (*pictures, moved.raw.dn, moved.views.viewmats, moved.views.Ks):
        assert tensor.device.type == "meta"
    assert (moved.raw.cfa, moved.raw.black, moved.raw.white) == ("RGGB", 64.0, 1023.0)
    assert moved.once("a", lambda: 2) == 2
    bare = problem().to("meta")
    assert (bare.linear16, bare.clean, bare.raw) == (None, None, None)


def test_the_fit_takes_seed_and_extent_of_the_problem():
    config = fit_for(problem(), FitConfig(iterations=9, seed=1, extent=1.0))
    assert (config.iterations, config.seed, config.extent) == (9, 7, 2.5)


def test_the_original_schedule_is_the_default():
    config = EnhancedFitConfig()
    assert config.fit is ORIGINAL_FIT
    assert ORIGINAL_FIT.rates.schedule == "original"
    assert ORIGINAL_FIT.mcmc.refine_stop == 25_000
    assert config.init_scale == ORIGINAL_SCALE == 0.1
    assert config.pictures == "8bit"


def gaussians() -> Gaussians:
    g = torch.Generator().manual_seed(0)
    return Gaussians.from_points(torch.rand(20, 3, generator=g) - 0.5, torch.rand(20, 3, generator=g), sh_degree=1)


def test_a_scene_of_gaussians_renders_colour_alpha_and_expected_depth():
    scene, cameras = gaussians(), views()
    image, alpha, depth = GaussianScene(scene).render(cameras)
    for mode, found in (("RGB", image), ("ED", depth[..., None])):
        expected, alphas, _ = rasterize(
            scene.means, scene.quats, scene.scales, scene.opacities, scene.sh, cameras.viewmats, cameras.Ks, 6, 4,
            sh_degree=1, render_mode=mode,
        )  # fmt: skip
        torch.testing.assert_close(found, expected)
        torch.testing.assert_close(alpha, alphas[..., 0])
    assert not image.requires_grad
    assert GaussianScene(scene).facts()["gaussians"] == 20


@pytest.mark.parametrize(("space", "enhancement"), [("enhanced", None), ("lit", {"enhancer": "guided"})])
def test_only_an_enhanced_reconstruction_states_its_enhancement(space, enhancement):
    with pytest.raises(ValueError, match="states its enhancement"):
        Reconstruction(scene=GaussianScene(gaussians()), space=space, config=None, enhancement=enhancement)


def test_first_colours_are_the_mean_target_of_pixels_with_the_same_code():
    g = torch.Generator().manual_seed(0)
    dark = (torch.rand(2, 5, 6, 3, generator=g) * 8).round() / 255
    targets = torch.rand(2, 5, 6, 3, generator=g)
    colors = torch.rand(40, 3, generator=g) * 12 / 255
    found = brightened(colors, dark, targets)
    for p in range(40):
        for c in range(3):
            codes = (dark[..., c] * 255).round()
            known = sorted(codes.unique().tolist())
            wanted = round(float(colors[p, c]) * 255)
            code = next((k for k in known if k >= wanted), known[-1])
            assert float(found[p, c]) == pytest.approx(float(targets[..., c][codes == code].mean()), rel=1e-5)


def test_first_gaussians_have_the_size_degree_and_colours_asked_for():
    g = torch.Generator().manual_seed(0)
    dark = torch.rand(2, 5, 6, 3, generator=g)
    start = SimpleNamespace(points=torch.rand(30, 3, generator=g), colors=torch.rand(30, 3, generator=g))
    found = start_gaussians(start, dark, dark.sqrt().requires_grad_(), sh_degree=2, init_scale=0.4)
    expected = Gaussians.from_points(
        start.points, brightened(start.colors, dark, dark.sqrt()), sh_degree=2, init_scale=0.4
    )
    for name, tensor in found.tensors().items():
        assert not tensor.requires_grad
        assert torch.equal(tensor, expected.tensors()[name])


def test_pictures_are_stacked_in_the_order_asked_for_each_read_once():
    pictures, read = np.arange(4 * 2 * 3, dtype=np.uint16).reshape(4, 2, 3), []

    def reader(i: int) -> np.ndarray:
        read.append(i)
        return pictures[i]

    found = stacked(reader, [3, 0, 2])
    assert found.dtype == torch.float32
    assert np.array_equal(found.numpy(), pictures[[3, 0, 2]])
    assert read == [3, 0, 2]


def test_pictures_are_read_when_they_are_used_and_not_kept():
    read = []

    def pictures() -> torch.Tensor:
        read.append("linear16")
        return torch.ones(2, 4, 6, 3)

    def frames() -> torch.Tensor:
        read.append("raw")
        return torch.ones(2, 4, 6, 3)

    given = problem(linear16=pictures, raw=RawPictures(dn=frames, cfa=None, black=0.0, white=1.0))
    assert given.encoded("8bit").shape == (2, 4, 6, 3)
    assert given.raw.cfa is None
    assert read == []
    assert given.encoded("16bit").shape == (2, 4, 6, 3)
    assert read == ["linear16"]
    assert given.raw.dn.shape == given.linear16.shape
    assert read == ["linear16", "raw", "linear16"]
    assert not any(isinstance(value, torch.Tensor) for value in vars(given.raw).values())
    assert problem().linear16 is None
    with pytest.raises(TypeError, match="dn"):
        RawPictures(cfa=None, black=0.0, white=1.0)
