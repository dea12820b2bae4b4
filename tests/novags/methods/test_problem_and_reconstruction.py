"""Claims about what methods get and give back."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from novags.methods import METHODS
from novags.methods.enhancers import enhancement_record, network_of, recorded
from novags.methods.enhancers.applying import enhanced, enhanced_clean
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.memo import Memo
from novags.methods.reconstruction import Reconstruction
from novags.settings import changed, has_setting
from novags.splats import Gaussians, Views, read_ply
from sensor_model import linear_to_srgb
from sensor_model.files.registry import Later


def test_the_linear_pictures_are_encoded_after_clipping(problem) -> None:
    base = problem()
    linear = torch.rand(base.srgb8.shape, generator=torch.Generator().manual_seed(0)) * 1.4 - 0.2
    found = replace(base, linear16=linear).encoded("16bit")
    expected = linear_to_srgb(np.clip(linear.numpy(), 0, 1)).astype(np.float32)
    assert (found.numpy() == expected).all()
    assert base.encoded("8bit") is base.srgb8
    with pytest.raises(ValueError, match="needs the 16-bit linear pictures, and this capture has none"):
        base.encoded("16bit")


@pytest.mark.parametrize("name", ["srgb8", "linear16", "clean"])
def test_pictures_of_another_shape_are_refused(problem, name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} must be \[C, H, W, 3\] = \[5, 24, 24, 3\]"):
        replace(problem(), **{name: torch.zeros(5, 24, 23, 3)})


def test_pictures_are_enhanced_once_for_all_methods_view_by_view(problem, monkeypatch) -> None:
    shared, base = Memo(), problem(sigma=0.02)
    first, second = (replace(base, shared=shared) for _ in range(2))
    one = enhanced(first, EnhanceConfig(), "8bit")
    calls = len(shared.kept)
    two = enhanced(second, EnhanceConfig(), "8bit")
    assert len(shared.kept) == calls == 5
    expected, params = enhance(base.srgb8, EnhanceConfig())
    assert torch.equal(one, expected)
    assert torch.equal(two, expected)
    assert torch.equal(enhanced_clean(first, EnhanceConfig(), "8bit"), enhance(base.clean, EnhanceConfig(), params)[0])
    enhanced(second, EnhanceConfig(target=0.3), "8bit")  # another enhancement is another result
    assert len(shared.kept) == 20  # the parameters of the five views by themselves too


def test_the_record_of_an_enhancement_makes_it_again() -> None:
    config = EnhanceConfig(target=0.4)
    enhancer, again = recorded(enhancement_record(config, "16bit"))
    assert again == config
    assert enhancer.enhance == Later(f"{enhance.__module__}:{enhance.__name__}")
    with pytest.raises(ValueError, match="unknown enhancer 'magic'"):
        recorded({"enhancer": "magic", "pictures": "8bit", "config": {}})
    with pytest.raises(ValueError, match="do not fit this version"):
        recorded({"enhancer": "guided", "pictures": "8bit", "config": {"colour": 1}})


def test_a_memo_drops_what_was_not_used_for_the_longest() -> None:
    memo, made = Memo(limit=3 * 80), list[int]()

    def make(k: int) -> np.ndarray:
        made.append(k)
        return np.full(10, float(k))

    for k in (0, 1, 2, 0, 3, 0, 1):  # 1 is dropped when 3 comes, because 0 was asked for again
        assert memo.once(k, lambda k=k: make(k))[0] == k
    assert made == [0, 1, 2, 3, 1]
    assert memo.size == 3 * 80


def test_a_space_and_an_enhancement_belong_together(problem) -> None:
    scene = GaussianScene(Gaussians.from_points(torch.rand(4, 3), torch.rand(4, 3), sh_degree=0))
    with pytest.raises(ValueError, match="'enhanced' states its enhancement"):
        Reconstruction(scene=scene, space="enhanced", config=None)
    with pytest.raises(ValueError, match="'enhanced' states its enhancement"):
        Reconstruction(scene=scene, space="lit", config=None, enhancement={"enhancer": "guided"})


def test_a_scene_of_gaussians_renders_all_it_is_made_of_and_saves_itself(tmp_path) -> None:
    """One opaque red splat in front of the camera: its colour, an opacity near 1, its depth; nothing elsewhere."""
    means = torch.tensor([[0.0, 0.0, 2.0]])
    red = torch.tensor([[1.0, 0.0, 0.0]])
    base = Gaussians.from_points(means.repeat(2, 1), red.repeat(2, 1), sh_degree=0)
    one = Gaussians(
        means=means, quats=base.quats[:1], log_scales=torch.full((1, 3), -2.0), logit_opacities=torch.tensor([9.0]),
        sh=base.sh[:1],
    )  # fmt: skip
    K = torch.tensor([[[40.0, 0, 16.5], [0, 40.0, 16.5], [0, 0, 1]]])
    image, alpha, depth = GaussianScene(one).render(Views(torch.eye(4)[None], K, 33, 33))
    assert image.shape == (1, 33, 33, 3)
    assert image[0, 16, 16].tolist() == pytest.approx([float(alpha[0, 16, 16]), 0, 0], abs=1e-5)
    assert float(alpha[0, 16, 16]) > 0.99
    assert float(depth[0, 16, 16]) == pytest.approx(2.0, abs=1e-5)
    assert float(alpha[0, 0, 0]) == float(depth[0, 0, 0]) == 0
    GaussianScene(one).save(tmp_path)
    assert torch.allclose(read_ply(tmp_path / "point_cloud.ply").means, means)
    assert GaussianScene(one).facts()["gaussians"] == 1


FITTED = [name for name, method in METHODS.items() if hasattr(method.config(), "fit")
          and network_of(getattr(method.config(), "enhance", None)) is None]  # fmt: skip
SHORT = {"fit.iterations": 3, "fit.rays": 16, "denoiser": None, "sh_weight": None, "denoise.turns": 1, "gaussians": 90,
         "denoise.adapt": None}  # fmt: skip


@pytest.mark.parametrize("name", FITTED)
def test_every_method_gives_back_the_configuration_that_it_fitted_with(dark, name: str) -> None:
    inputs, light = dark(seed=1)
    inputs = replace(inputs, clean=torch.from_numpy(linear_to_srgb(light.numpy())).float().clamp(0, 1))
    method = METHODS[name]
    given = method.config()
    settings = {key: value for key, value in SHORT.items() if has_setting(given, key)}
    if has_setting(given, "render_weight"):  # what learns from renders adapts
        settings = {**settings, "denoise.adapt": replace(given.denoise.adapt, steps=1)}
    found = method.train(inputs, changed(given, settings, what=name)).config
    assert found.fit.seed == 1
    if hasattr(found.fit, "extent"):
        assert found.fit.extent == inputs.start.extent
