"""How a scene of Gaussians shows its colours."""

from dataclasses import replace

import pytest
import torch

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.tone import ResponseTable, ToneCurve
from novags.splats.gaussians import Gaussians
from novags.splats.views import Views


def test_each_pixel_goes_through_tone_then_matrix_then_response(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expectation: the matrix mixes light, neither tones nor codes; depth and alpha have no colours."""
    g = torch.Generator().manual_seed(3)
    drawn, alpha = torch.rand(2, 5, 6, 4, generator=g), torch.rand(2, 5, 6, 1, generator=g)
    monkeypatch.setattr(GaussianScene, "splatted", lambda *args, **options: (drawn, alpha))
    plain = GaussianScene(Gaussians.from_points(torch.rand(4, 3), torch.rand(4, 3), sh_degree=0))
    views = Views(torch.eye(4).repeat(2, 1, 1), torch.eye(3).repeat(2, 1, 1), 6, 5)
    tone = ToneCurve(top=2.0, k=0.3)
    matrix = torch.tensor([[1.6, -0.5, -0.1], [-0.2, 1.5, -0.3], [0.1, -0.6, 1.5]])
    response = ResponseTable(faint=0.01, low=-5.0, high=1.0, values=(0.0, 0.2, 1.0))
    light = tone.light(drawn[..., :3])
    mixed = torch.stack([sum(light[..., c] * matrix[row, c] for c in range(3)) for row in range(3)], -1)
    assert float((mixed - light).abs().max()) > 0.1
    steps = {"tone": tone, "matrix": matrix, "response": response}
    for chosen, want in {("tone", "matrix"): mixed, ("tone", "matrix", "response"): response.codes(mixed)}.items():
        found = replace(plain, **{name: steps[name] for name in chosen}).render(views)
        torch.testing.assert_close(found[0], want)
        assert torch.equal(found[1], alpha[..., 0])
        assert torch.equal(found[2], drawn[..., 3])


def test_a_response_is_read_off_its_table_between_its_ends() -> None:
    """Expectation: equal factors of radiance are equal steps in the table; beyond its ends the last values hold."""
    response = ResponseTable(faint=0.01, low=-4.5, high=1.5, values=(0.1, 0.2, 0.8))
    logs = torch.tensor([-4.5, -3.0, -1.5, 0.0, 1.5, 2.0], dtype=torch.float64)
    found = response.codes(torch.exp(logs) - 0.01)
    want = torch.tensor([0.1, 0.15, 0.2, 0.5, 0.8, 0.8], dtype=torch.float64)
    torch.testing.assert_close(found, want)
