"""The error of held-out views, at another size than that of the training views."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from novags.methods.gaussian_scene import GaussianScene
from novags.testbed.study.knobs import reconstruction


def test_a_splat_is_dilated_by_as_much_of_the_picture_at_the_full_size(monkeypatch: pytest.MonkeyPatch) -> None:
    dilations: list[float] = []

    def render(scene: GaussianScene, views: Any) -> Any:
        dilations.append(scene.eps2d)
        return torch.zeros(1, 4, 4, 3), None, None

    frame = SimpleNamespace(of=lambda *given: SimpleNamespace(view=lambda i, device: None))
    monkeypatch.setattr(GaussianScene, "render", render)
    monkeypatch.setattr(reconstruction, "CoordinateFrame", frame)
    monkeypatch.setattr(reconstruction, "pictured", lambda run, capture, rendered: rendered)
    monkeypatch.setattr(reconstruction, "enhanced_truth", lambda *given: None)
    monkeypatch.setattr(reconstruction, "aligned_psnr", lambda *given: 20.0)
    rigs = (SimpleNamespace(rig=SimpleNamespace(width=width), test_indices=[0]) for width in (16, 48))
    small, whole = (SimpleNamespace(cameras=rig) for rig in rigs)
    result: Any = SimpleNamespace(scene=GaussianScene(None, 0.3, False), enhancement={}, viewmats=None)
    prepared: Any = SimpleNamespace(indices=[], estimate=None, device="cpu")
    assert reconstruction.held_out_error(result, prepared, small, whole) == pytest.approx(10.0)  # 20 dB below white
    assert dilations == [pytest.approx(9 * 0.3)]  # px^2, three times as many px
