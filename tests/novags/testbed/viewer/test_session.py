"""Claims about one browser's session that need no browser."""

import json
import shutil
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.viewer.server import address_of
from novags.testbed.viewer.session import Session
from novags.testbed.viewer.shown import shown_of


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
