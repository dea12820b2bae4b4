"""The noise of a rendered truth goes through the chain of every reference, and scores against it lose what it adds."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.references import references
from novags.testbed.folders.set import open_source
from novags.testbed.folders.truth_noise import over, reference_halves, references_at
from novags.testbed.metrics.truth import ERROR, variance_of
from novags.testbed.stages.capturing import capture
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from novags.testbed.stages.rendering import render
from sensor_model.isp import linear_to_srgb

QUIET = Console(quiet=True)
SCRIPT = Path(__file__).resolve().parents[4] / "scripts" / "scores" / "bench_truth_noise.py"
SCENES = ("tabletop", "cornell", "bookshop", "busts")


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    spec = spec_from_file_location("bench_truth_noise", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A render of few samples, photographed by three chips and through a mosaic."""
    folder = tmp_path_factory.mktemp("truth")
    render(folder / "set", RenderConfig(n_views=3, width=32, height=32, spp=16, truth_samples=1), QUIET)
    for sensor in ("a7s2-iso6400-3chip", "a7s2-iso6400"):
        capture(folder / "set", folder / sensor, CaptureConfig(sensor=sensor, electrons=50.0), QUIET)
    return folder


@pytest.mark.parametrize("sensor", ["a7s2-iso6400-3chip", "a7s2-iso6400"])
def test_every_reference_has_halves_and_is_what_light_of_the_mean_makes(
    sensor: str, folder: Path, bench: ModuleType
) -> None:
    lit, dark = open_source(folder / "set", QUIET), open_capture(folder / sensor)
    for space in ("enhanced", "linear"):
        run: Any = SimpleNamespace(enhancement=bench.ENHANCEMENT, space=space, lacks=None)
        right = references(run, dark, lit, 0)
        same = references_at(run, dark, lit, 0, np.ones((32, 32, 3), np.float32))
        halves = reference_halves(run, dark, lit, 0)
        assert right.keys() == same.keys() == halves.keys()
        for kind, image in right.items():
            np.testing.assert_allclose(same[kind], image, atol=0.51 / 255 if kind == "lit" else 1e-4)
            assert 0 < variance_of(*halves[kind]).mean() < np.var(image)


def test_halves_of_the_well_lit_picture_are_those_of_the_light(folder: Path, bench: ModuleType) -> None:
    lit = open_source(folder / "set", QUIET)
    light, half, exposure = lit.radiance(0), lit.half(0), lit.views.meta["exposure_scale"]
    assert half is not None
    first, second = reference_halves(bench.RUN, open_capture(folder / "a7s2-iso6400-3chip"), lit, 0)["lit"]
    for found, radiance in ((first, light + half), (second, light - half)):
        np.testing.assert_allclose(found, linear_to_srgb(np.clip(radiance * exposure, 0, 1)), atol=1e-5)


def test_photographs_have_no_halves(folder: Path, bench: ModuleType) -> None:
    lit = SimpleNamespace(half=lambda i: None)
    assert reference_halves(bench.RUN, open_capture(folder / "a7s2-iso6400"), lit, 0) == {}  # type: ignore[arg-type]
    assert open_source(folder / "a7s2-iso6400", QUIET).half(0) is None  # a capture is a folder of photographs


def test_light_over_black_is_nothing() -> None:
    np.testing.assert_array_equal(over(np.array([0.5, 0.0]), np.array([2.0, 0.0])), [0.25, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_a_corrected_score_lies_within_its_errors_of_the_score_against_sixteen_times_the_samples(
    scene: str, tmp_path: Path, bench: ModuleType
) -> None:
    """96 samples against 1536; without the correction scores are too low by many errors."""
    for here, better in bench.compared(scene, tmp_path, 64, 96, 4).values():
        for name in (name.removesuffix(ERROR) for name in here if name.endswith(ERROR)):
            error = np.hypot(here[name + ERROR], better[name + ERROR])
            assert abs(here[name] - better[name]) < 2.5 * error
            assert here[f"plain_{name}"] < better[name] - 5 * error
