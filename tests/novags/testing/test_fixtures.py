"""Claims about the fixture: what it makes, that it makes it once, that it costs nobody anything who does not ask."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from novags.testbed.folders import references
from novags.testbed.ledger.store import files_of
from novags.testbed.study.entry import Task
from novags.testing import DarkCapture, making
from novags.testing.known import PosedViews
from novags.testing.making import make_capture
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

Make = Callable[..., DarkCapture]
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    names, rng = [f"{i:04d}" for i in range(9)], np.random.default_rng(0)
    write_cameras(tmp_path / "photos", names, orbit_rig(9, 24, 24, 50.0, radius=3.0))
    for name in names:
        write_png(tmp_path / "photos" / "images" / f"{name}.png", rng.integers(20, 250, (24, 24, 3)).astype(np.uint8))
    return tmp_path / "photos"


def test_a_capture_is_small_dark_and_has_the_light_that_was_asked_for(dark_capture: Make) -> None:
    dark = dark_capture("cornell", 20)
    assert (len(dark.train), len(dark.test)) == (7, 2)
    assert dark.test.names == ("0000", "0008")
    assert dark.train.pictures.shape == dark.train.lit.shape == (7, 48, 48, 3)
    assert dark.train.raw.dtype == np.uint16
    assert dark.electrons == 20
    assert dark.train.pictures.mean() < 0.3 * dark.train.lit.mean()
    assert dark.train.linear.min() < 0  # noise around black is kept
    z = dark.points @ dark.train.viewmats[0, :3, :3].T + dark.train.viewmats[0, :3, 3]
    assert (z[:, 2] > 0).mean() > 0.9  # they lie before the cameras


def test_pictures_and_truth_are_of_every_view(monkeypatch: pytest.MonkeyPatch) -> None:
    def of(i: int, kind: str = "", shape: tuple[int, ...] = (2, 2, 3)) -> np.ndarray:
        return np.full(shape, 10 * i + len(kind))

    capture: Any = SimpleNamespace(srgb8=of, linear16=of, raw=of, clean_linear=of, truth=of)
    source: Any = SimpleNamespace(views=SimpleNamespace(path="photographs"))
    monkeypatch.setattr(references, "true_depth", lambda _, i: None if i == 5 else of(i, shape=(2, 2)))
    parts: dict[str, Any] = {"viewmats": np.eye(4)[None], "Ks": np.eye(3)[None], "width": 2, "height": 2}
    views = PosedViews(("b", "d"), **parts, _indices=(1, 3), _capture=capture, _source=source)
    for found in (views.pictures, views.linear, views.raw, views.clean_linear, views.depth):
        np.testing.assert_array_equal(found[:, 0, 0].reshape(2, -1)[:, 0], [10, 30])
    np.testing.assert_array_equal(views.mean_dn[:, 0, 0, 0], [14, 34])
    np.testing.assert_array_equal(views.variance_dn[:, 0, 0, 0], [18, 38])
    with pytest.raises(ValueError, match="the depth of photographs is not known"):
        _ = PosedViews(("b", "f"), **parts, _indices=(1, 5), _capture=capture, _source=source).depth


def test_every_view_has_the_name_and_the_camera_of_its_number(tmp_path: Path) -> None:
    rig = orbit_rig(5, 24, 16, 50.0, radius=3.0)
    cameras = SimpleNamespace(names=tuple("abcde"), rig=rig, train_indices=[1, 2, 4], test_indices=[0, 3])
    record = SimpleNamespace(simulated=SimpleNamespace(electrons=7))
    capture: Any = SimpleNamespace(path=tmp_path, cameras=cameras, record=record)
    source: Any = SimpleNamespace(points=lambda: None)
    dark = DarkCapture.of(capture, source)
    assert (dark.folder, dark.electrons, dark.points.shape) == (tmp_path, 7.0, (0, 3))
    for views, indices in ((dark.train, [1, 2, 4]), (dark.test, [0, 3])):
        assert views.names == tuple("abcde"[i] for i in indices)
        np.testing.assert_array_equal(views.viewmats, [rig.viewmats[i] for i in indices])
        np.testing.assert_array_equal(views.Ks, [rig.Ks[i] for i in indices])


def test_an_entry_is_made_of_the_contents_of_all_that_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[Any]()

    def ensured(order: Any, *_: Any) -> dict[str, str]:
        asked.append(order)
        return {"content": "of the run"}

    monkeypatch.setattr(making, "ensure", ensured)
    monkeypatch.setattr(making, "steps", lambda *_: [])
    monkeypatch.setattr(making, "depends", lambda _: ())
    planner: Any = SimpleNamespace(tasks={key: Task("capture", key, f"{key}-1", None) for key in ("dark", "lit")})
    task = Task("run", "r", "r-1", None, needs=("dark", "lit"))
    assert making._made(task, tmp_path, planner, {"dark": "d", "other": "o", "lit": "l"}) == "of the run"
    (order,) = asked
    assert order.made_of == {"dark": "d", "lit": "l"}
    assert (order.folder, order.source) == (tmp_path / "run" / "r-1", tmp_path / "capture" / "dark-1")


def test_equal_arguments_are_one_capture_and_others_share_its_set(dark_capture: Make) -> None:
    dark = dark_capture("cornell", 20)
    assert dark_capture("cornell", electrons=20.0, views=9) is dark
    other = dark_capture("cornell", 5)
    assert other is not dark
    assert np.array_equal(other.train.lit, dark.train.lit)
    assert other.train.clean_linear.mean() == pytest.approx(dark.train.clean_linear.mean() / 4, rel=0.01)


def test_two_stores_hold_the_same_bytes_and_neither_is_filled_twice(photographs: Path, tmp_path: Path) -> None:
    made = [make_capture(tmp_path / store, str(photographs), 10.0, {"seed": 3}) for store in ("a", "b")]
    first, second = (files_of(dark.folder, ["capture.json"]) for dark in made)
    assert first.keys() == second.keys()
    different = {name for name in first if first[name] != second[name]}
    assert different <= {"capture.json"}  # which says what it cost
    before = {path: path.stat().st_mtime_ns for path in made[0].folder.rglob("*") if path.is_file()}
    assert make_capture(tmp_path / "a", str(photographs), 10.0, {"seed": 3}) is made[0]
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_a_damaged_file_is_made_again(photographs: Path, tmp_path: Path) -> None:
    first = make_capture(tmp_path / "store", str(photographs), 10.0, {})
    known = first.train.raw
    (first.folder / "raw" / "0001.dng").write_bytes(b"damaged")
    again = make_capture(tmp_path / "store", str(photographs), 10.0, {})
    assert np.array_equal(again.train.raw, known)
    assert b"damaged" not in (first.folder / "raw" / "0001.dng").read_bytes()


def test_photographs_have_no_depth_and_say_so(photographs: Path, tmp_path: Path) -> None:
    dark = make_capture(tmp_path / "store", str(photographs), 10.0, {})
    with pytest.raises(ValueError, match="depth of .* is not known: only rendered scenes have it"):
        _ = dark.test.depth


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"iterations": 10}, "dark_capture: iterations belongs to a reconstruction"),
        ({"fit.sh_degree": 1}, "dark_capture: fit.sh_degree is a setting of methods"),
        ({"veiws": 10}, "dark_capture: veiws: there is no such key; did you mean 'views'"),
    ],
)
def test_what_a_capture_has_not_is_refused(tmp_path: Path, settings: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make_capture(tmp_path, "cornell", 10.0, settings)


def test_photographs_without_cameras_take_the_place_of_a_scene(tmp_path: Path) -> None:
    """Rationale: the scene that nobody had named stood in their way."""
    with pytest.raises(ValueError, match="holds 0 photographs"):
        make_capture(tmp_path / "store", None, 10.0, {"photos": str(tmp_path)})
    with pytest.raises(ValueError, match="not both"):
        make_capture(tmp_path / "store", "cornell", 10.0, {"photos": str(tmp_path)})


def test_loading_the_plugin_loads_nothing_heavy() -> None:
    code = "import sys, novags.testing; print([m for m in ('torch', 'mitsuba', 'cv2', 'scipy') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert found.stdout.strip() == "[]"


def test_the_ten_lines_of_the_page_are_ten_and_pass(
    blocks: Callable[..., list[str]], pytester: pytest.Pytester, novags_store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    test, reconstructor = blocks("testing-your-reconstructor.md")
    assert len([line for line in test.splitlines() if line.strip()]) == 10
    pytester.makepyfile(test_mine=test, my_reconstructor=reconstructor)
    pytester.makeconftest(
        "import pytest, pathlib\n@pytest.fixture(scope='session')\n"
        f"def novags_store():\n    return pathlib.Path({str(novags_store)!r})\n"
    )
    # In a process of its own: pytester forgets the modules that it loaded, and some of them abort when loaded twice.
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    found = pytester.runpytest_subprocess("-q", "-W", "error")
    found.assert_outcomes(passed=2)
