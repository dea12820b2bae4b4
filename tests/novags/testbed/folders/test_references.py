"""Claims about the references of pictures, and about what light is shown as."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.enhancers import recorded
from novags.methods.enhancers.applying import enhanced_like, enhanced_view
from novags.methods.problem import encode
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.references import enhanced_truth, pictured
from tests.fuzz.readers.records import make_capture

CONFIGS: tuple[dict[str, Any], ...] = ({"window": 5}, {"window": 9, "target": 0.4})


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("referred")
    make_capture(folder)
    return open_capture(folder / "capture")


def fresh(capture: Capture) -> Capture:
    return replace(capture, memo=type(capture.memo)())


def run(pictures: str, config: dict[str, Any]) -> Any:
    return SimpleNamespace(space="linear",
                           enhancement={"enhancer": "guided", "pictures": pictures, "config": config})  # fmt: skip


def test_light_is_shown_with_the_parameters_that_all_training_views_have_on_average(capture: Capture) -> None:
    light = np.random.default_rng(0).uniform(0, 0.1, (24, 32, 3)).astype(np.float32)
    indices = capture.cameras.train_indices
    assert len(indices) == 2
    shown, together = [], fresh(capture)
    for one in [run(pictures, config) for pictures in ("8bit", "16bit") for config in CONFIGS]:
        enhancer, config = recorded(one.enhancement)
        pictures = one.enhancement["pictures"]
        params = [enhanced_view(fresh(capture).memo, capture.names[i], torch.from_numpy(
            capture.dark(i, pictures).copy()), config, pictures, capture.noise)[1] for i in indices]  # fmt: skip
        expected = enhanced_like(torch.from_numpy(encode(light)), config, enhancer.typical(params)).numpy()
        shown.append(pictured(one, together, light))
        np.testing.assert_array_equal(shown[-1], expected)
        np.testing.assert_array_equal(pictured(one, together, light), expected)
    assert len({picture.tobytes() for picture in shown}) == 4


def test_the_clean_exposure_is_enhanced_as_its_noisy_twin_was(capture: Capture) -> None:
    for i in range(2):
        one = run("16bit", CONFIGS[0]).enhancement
        config = recorded(one)[1]
        dark, clean = (torch.from_numpy(image.copy()) for image in (capture.dark(i, "16bit"), capture.clean(i)))
        params = enhanced_view(fresh(capture).memo, "x", dark, config, "16bit", capture.noise)[1]
        expected = enhanced_like(clean, config, params).numpy()
        np.testing.assert_allclose(enhanced_truth(fresh(capture), i, one), expected, atol=1e-6)
