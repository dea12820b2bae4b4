"""Claims about one browser's session that need no browser."""

import json
import shutil
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.viewer.panel import ControlPanel
from novags.testbed.viewer.server import address_of
from novags.testbed.viewer.session import Session
from novags.testbed.viewer.shown import shown_of
from novags.testbed.viewer.world import SIZE
from tests.miniatures import unsealed


def test_what_cannot_be_exposed_is_said_and_hides_no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A black model has no light to expose, but its pictures must stay visible: they show what went wrong."""
    done: list[str] = []

    def black(_: Session) -> None:
        raise ValueError("the light is black")

    for step in ("_enter", "_offer", "_show_splats", "_show_estimated", "_show_pictures", "_clear_the_view"):
        monkeypatch.setattr(Session, step, lambda _, step=step: done.append(step))
    monkeypatch.setattr(Session, "_show_light", black)
    monkeypatch.setattr(Session, "_say", lambda _, trouble: done.append(trouble))
    session = object.__new__(Session)
    session.latest, session.has_gaussians = SimpleNamespace(over=False), True  # type: ignore[assignment]
    session.panel = SimpleNamespace(method=SimpleNamespace(value="naive"))  # type: ignore[assignment]
    session._update(frozenset({"capture"}))
    said = "**ValueError**: the light is black"
    steps = ["_enter", "_offer", "_show_splats", "_show_estimated", "_show_pictures", "_clear_the_view"]
    assert done == [*steps, said]


def test_the_box_for_cameras_shows_and_hides_those_of_the_method_too(runs: dict[str, Path], tmp_path: Path) -> None:
    """Rationale: they came and went with the Gaussians, and a field had none."""
    for part in ("photos", "capture", "first"):
        shutil.copytree(runs["capture"].parent / part, tmp_path / part)
    path = tmp_path / "first" / "cameras.json"
    listed = json.loads(path.read_text())
    listed[2]["position"][0] += 0.5
    path.write_text(json.dumps(listed))
    (tmp_path / "first" / "point_cloud.ply").unlink()  # as of a method that makes no Gaussians
    there = dict[str, Any]()

    def add(name: str, *_: Any, **__: Any) -> Any:
        there[name] = SimpleNamespace(remove=lambda: there.pop(name))
        return there[name]

    session = object.__new__(Session)
    session.all_shown = shown_of([tmp_path / "first"], Console(quiet=True))
    session.client = SimpleNamespace(scene=SimpleNamespace(add_camera_frustum=add))
    boxes = {"capture": "", "method": "naive", "splats": False, "cameras": True}
    session.panel = SimpleNamespace(**{name: SimpleNamespace(value=v) for name, v in boxes.items()})  # type: ignore[assignment]
    session.estimated = []
    session._show_estimated()
    assert list(there) == [f"/estimated/{listed[2]['img_name']}"]
    session.panel.cameras.value = False
    session._show_estimated()
    assert not there


def scored(folder: Path, source: dict[str, Path], values: dict[str, float]) -> list[Path]:
    """Copies of the runs with these aligned PSNR, as far as they have one."""
    for part in ("photos", "capture", "first", "second"):
        shutil.copytree(source["capture"].parent / part, folder / part)
    for name, value in values.items():
        stages.score(folder / name, Console(quiet=True))
        found = json.loads((folder / name / "metrics.json").read_text())
        (scores,) = found["methods"].values()
        for own in (scores["mean"], *scores["views"].values()):
            own["enhanced"]["aligned_psnr"] = value
        (folder / name / "metrics.json").write_text(json.dumps(found))
        unsealed(folder / name / "metrics.json")
    return [folder / "first", folder / "second"]


@pytest.mark.parametrize(
    ("values", "pair"),
    [
        ({"first": 20.0, "second": 25.0}, ("naive-l1", "naive")),
        ({"first": 26.0, "second": 25.0}, ("naive", "naive-l1")),
        ({}, ("naive-l1", "naive")),  # not scored: the first that is no bound, beside the floor
    ],
)
def test_it_begins_with_the_best_method_beside_the_floor(
    runs: dict[str, Path], tmp_path: Path, values: dict[str, float], pair: tuple[str, str]
) -> None:
    (shown,) = shown_of(scored(tmp_path, runs, values), Console(quiet=True))
    assert shown.pair == pair
    (alone,) = shown_of([tmp_path / "first"], Console(quiet=True))
    assert alone.pair == ("naive", "naive")


def test_it_begins_in_a_training_view_and_sees_what_that_camera_saw(runs: dict[str, Path]) -> None:
    session = object.__new__(Session)
    session.all_shown = shown_of([runs["first"], runs["second"]], Console(quiet=True))
    camera = SimpleNamespace()
    session.client = SimpleNamespace(
        scene=SimpleNamespace(set_up_direction=lambda up: None), camera=camera, atomic=nullcontext
    )
    session.plates = {}
    controls = {name: SimpleNamespace(value="…", options=("…",), visible=True)
                for name in ("capture", "method", "other", "switch")}  # fmt: skip
    offer = ControlPanel.offer
    session.panel = SimpleNamespace(**controls, offer=lambda *given: offer(session.panel, *given))  # type: ignore[assignment]
    session._enter()
    (shown,) = session.all_shown
    train = shown.capture.cameras.train_indices[0]
    viewmat = shown.world.viewmats[train]
    assert camera.position == pytest.approx(-viewmat[:3, :3].T @ viewmat[:3, 3])
    assert (viewmat[:3, :3] @ (camera.look_at - camera.position)) / 3 == pytest.approx([0, 0, 1], abs=1e-9)
    assert shown.world.nearest(viewmat) not in shown.capture.cameras.test_indices
    assert (session.panel.method.value, session.panel.other.value) == shown.pair
    assert session.panel.switch.visible
    controls["method"].value = "naive"  # what was chosen stays, as on another capture of the same methods
    session._enter()
    assert session.panel.method.value == "naive"


def test_frusta_are_small_beside_the_scene_however_many_there_are(runs: dict[str, Path]) -> None:
    made = list[float]()
    session = object.__new__(Session)
    session.all_shown = shown_of([runs["first"]], Console(quiet=True))
    add = SimpleNamespace(add_camera_frustum=lambda *_, scale, **more: made.append(scale))
    session.client, session.panel = SimpleNamespace(scene=add), SimpleNamespace(capture=SimpleNamespace(value=""))  # type: ignore[assignment]
    for viewmat in session.shown.world.viewmats:
        session._frustum("/cameras/x", viewmat, (0, 0, 0))
    assert 0 < max(made) <= SIZE / 20


def test_all_gaussians_of_the_method_before_are_taken_away(monkeypatch: pytest.MonkeyPatch) -> None:
    removed: list[int] = []
    session = object.__new__(Session)
    session.nodes = [SimpleNamespace(remove=lambda k=k: removed.append(k)) for k in range(3)]
    monkeypatch.setattr(Session, "shown", SimpleNamespace(scene=lambda name: None))
    session.computing = nullcontext()  # type: ignore[assignment]
    session.panel = SimpleNamespace(method=SimpleNamespace(value="naive"))  # type: ignore[assignment]
    session._show_splats()
    assert (removed, session.nodes) == ([0, 1, 2], [])


@pytest.mark.parametrize(
    ("host", "address"),
    [
        ("127.0.0.1", "http://127.0.0.1:8080"),
        ("0.0.0.0", "http://localhost:8080"),
        ("::", "http://localhost:8080"),
        ("::1", "http://[::1]:8080"),
        ("", "http://localhost:8080"),
    ],
)
def test_the_address_can_be_opened_whatever_the_network_interface(host: str, address: str) -> None:
    assert address_of(host, 8080) == address


def test_each_run_has_a_scene_of_its_own_that_is_read_once(runs: dict[str, Path]) -> None:
    (shown,) = shown_of([runs["first"], runs["second"]], Console(quiet=True))
    first, second = (shown.scene(name) for name in shown.runs)
    assert first is not None
    assert second is not None
    means = [scene[0].gaussians.means for scene in (first, second)]  # type: ignore[attr-defined]
    assert means[0].shape != means[1].shape or not bool((means[0] == means[1]).all())
    assert shown.scene(next(iter(shown.runs))) is first
