"""Each setting of the splat engine's constants has machine code of its own; their defaults have that of the engine."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from novags.splats.raster import raster_torch
from novags.testbed.study.knobs.splat_engine import child
from novags.testbed.study.knobs.splat_engine.scene import NAMES, cube_scene, reference

splats = import_module("novags.testbed.study.knobs.splats")  # the package's own name is the subject


@pytest.mark.parametrize("knob", splats.KNOBS)
def test_machine_code_that_knobs_share_is_that_of_unchanged_constants(
    knob: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: code that a refitted polynomial was compiled into would serve all other knobs."""
    asked: list[tuple[dict[str, Any], Path]] = []

    def in_child(order: dict[str, Any], code: str) -> dict[str, Any]:
        asked.append((order, code))
        if order["do"] == "truth":
            Path(order["out"]).write_bytes(b"truth")
        else:
            assert Path(order["truth"]).read_bytes() == b"truth"
        return {"seconds": 1.0, "cpu_seconds": 1.0, "error": 0.0}

    monkeypatch.setattr(splats, "in_child", in_child)
    splats.truth.cache_clear()
    for setting in splats.KNOBS[knob][0]:
        splats.measured(knob, setting, 8, 8, 0)
    splats.truth.cache_clear()
    assert sum(order["do"] == "truth" for order, _ in asked) == 1
    measures = [(order, code) for order, code in asked if order["do"] == "measure"]
    assert [order["changed"] for order, _ in measures] == [code != "default" for _, code in measures]
    assert len({code for order, code in measures if order["changed"]}) == sum(o["changed"] for o, _ in measures)


@pytest.mark.parametrize("changed", [False, True])
def test_constants_are_changed_where_the_machine_code_is_a_settings_own(
    changed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turned: list[Any] = []

    def draw(scene: dict[str, torch.Tensor], Ks: torch.Tensor, width: int, height: int, **_: Any) -> torch.Tensor:
        shade: Any = sum(scene[name].sum() for name in NAMES)
        return shade * torch.ones(height, width, 3)

    monkeypatch.setattr(child, "turn", lambda *given: turned.append(given))
    monkeypatch.setattr(child, "draw", draw)
    np.save(tmp_path / "truth.npy", np.zeros((8, 8, 3)))
    child.measure("exp2_degree", 5, changed=changed, n=4, size=8, seed=0, truth=str(tmp_path / "truth.npy"))
    assert turned == ([("exp2_degree", 5)] if changed else [])


@pytest.mark.parametrize(("knob", "setting"), [("exp2_degree", 5), ("float_bits", 64)], ids=["drawn", "plain"])
def test_a_picture_is_of_the_scene_of_its_seed(
    knob: str, setting: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the same picture its error is nothing."""

    def draw(scene: dict[str, torch.Tensor], *_: Any, **__: Any) -> torch.Tensor:
        shade: Any = sum(scene[name].sum() for name in NAMES)
        return shade * torch.ones(8, 8, 3)

    monkeypatch.setattr(child, "draw", draw)
    monkeypatch.setattr(child, "fastest", lambda call, times: (0.0, 0.0))
    for seed, other in ((3, 4), (4, 3)):
        shown = reference(6, 8, seed, exact=False, bits=64) if knob == "float_bits" else draw(cube_scene(6, 8, seed))
        np.save(tmp_path / f"{seed}.npy", shown.numpy())
        truth = str(tmp_path / f"{seed}.npy")
        errors = [
            child.measure(knob, setting, changed=False, n=6, size=8, seed=each, truth=truth)["error"]
            for each in (seed, other)
        ]
        assert errors[0] == 0 < errors[1]


@pytest.mark.parametrize("supersampled", [False, True])
def test_the_truth_of_another_seed_is_another_picture(
    supersampled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ALPHA_MIN", "TRANSMITTANCE_MIN"):  # the child sets them for its whole process: they come back after
        monkeypatch.setattr(raster_torch, name, getattr(raster_torch, name))
    pictures = []
    for k, seed in enumerate((3, 3, 4)):
        child.truth(str(tmp_path / f"{k}.npy"), n=12, size=8, seed=seed, supersampled=supersampled)
        pictures.append(np.load(tmp_path / f"{k}.npy"))
    assert pictures[0].shape == (8, 8, 3)
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.allclose(pictures[0], pictures[2])


def test_another_seed_draws_another_scene_and_another_picture() -> None:
    first, again, other = (cube_scene(6, 8, seed) for seed in (3, 3, 4))
    for name in NAMES:
        assert torch.equal(first[name], again[name])
        assert not torch.equal(first[name], other[name])
    pictures = [reference(12, 8, seed, exact=False) for seed in (3, 3, 4)]
    assert torch.equal(pictures[0], pictures[1])
    assert not torch.allclose(pictures[0], pictures[2])


@pytest.mark.parametrize("knob", ["eps2d", "backend"])
def test_a_setting_is_measured_on_the_scene_of_its_seed_against_the_truth_of_it(
    knob: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[dict[str, Any]]()

    def in_child(order: dict[str, Any], code: str) -> dict[str, Any]:
        asked.append(order)
        if order["do"] == "truth":
            Path(order["out"]).write_bytes(f"truth of {order['seed']}".encode())
        else:
            assert Path(order["truth"]).read_bytes() == f"truth of {order['seed']}".encode()
        return {"seconds": 1.0, "cpu_seconds": 1.0, "error": 0.0}

    monkeypatch.setattr(splats, "in_child", in_child)
    splats.truth.cache_clear()
    (turned,) = [each for each in splats.splats(8, 16).knobs if each.name == knob]
    for seed in (5, 6):
        turned.measure(turned.settings[0], seed, None)
    splats.truth.cache_clear()
    assert [(order["do"], order["seed"]) for order in asked] == [
        ("truth", 5), ("measure", 5), ("truth", 6), ("measure", 6)
    ]  # fmt: skip
    assert {(order["n"], order["size"]) for order in asked} == {(8, 16)}
