from types import SimpleNamespace

import torch

from novags.methods.start import brightened, start_gaussians


def test_colours_follow_the_curve_from_dark_to_target_of_each_channel():
    dark = torch.linspace(0, 1, 256).reshape(1, 16, 16, 1).repeat(1, 1, 1, 3)
    curves = torch.tensor([0.3, 0.5, 2.0])
    colors = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    found = brightened(colors, dark, dark**curves)
    codes = (colors * 255).round() / 255
    torch.testing.assert_close(found, codes**curves, atol=1e-5, rtol=0)


def test_codes_that_no_pixel_has_take_the_next_one():
    dark = torch.full((1, 2, 2, 3), 0.2)
    dark[0, 0] = 0.6
    targets = dark + 0.3
    colors = torch.tensor([[0.0, 0.3, 0.9]])
    torch.testing.assert_close(brightened(colors, dark, targets), torch.tensor([[0.5, 0.9, 0.9]]))


def test_gaussians_start_at_the_points_in_the_targets_colours():
    dark = torch.rand(2, 8, 8, 3, generator=torch.Generator().manual_seed(0)) * 0.2
    init = SimpleNamespace(points=torch.rand(20, 3), colors=dark[0].reshape(-1, 3)[:20], extent=1.0)
    gaussians = start_gaussians(init, dark, 4 * dark, sh_degree=2, init_scale=0.7)
    assert torch.equal(gaussians.means, init.points)
    assert gaussians.sh.shape == (20, 9, 3)
    rgb = 0.5 + 0.28209479177387814 * gaussians.sh[:, 0]
    # Colours fall into 8-bit codes, four times as wide in the targets.
    assert (rgb - 4 * init.colors).abs().max() <= 4 / 255


def test_a_code_takes_its_mean_over_all_views():
    dark, targets = torch.full((2, 2, 2, 3), 0.2), torch.full((2, 2, 2, 3), 0.4)
    targets[1] = 0.8
    torch.testing.assert_close(brightened(torch.full((1, 3), 0.2), dark, targets), torch.full((1, 3), 0.6))
