"""Claims about the sentence on the work that was done: how many views, of how many, by which methods."""

from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report.blocks.header import short, what_was_done


def place(kind: str, lost: int, simulated: bool = True) -> Any:
    told = SimpleNamespace(electrons=20.0) if simulated else None
    record = SimpleNamespace(width=64, height=48, views=8, sensor_name="eye", simulated=told)
    views = SimpleNamespace(kind=kind, unregistered=[f"{k}.png" for k in range(lost)])
    return SimpleNamespace(scene="hall", capture=SimpleNamespace(record=record), lit=SimpleNamespace(views=views),
                           runs=dict.fromkeys("abc"), metrics={"methods": {}}, one_reference=True)  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "lost", "said"),
    [("rendered", 0, "8 views of hall (64 × 48 px) were rendered, taken in the dark"),
     ("photographs", 0, "8 photographs of hall (64 × 48 px) were taken in the dark"),
     ("photographs", 3, "8 of 11 photographs of hall (64 × 48 px) were taken in the dark")],
)  # fmt: skip
def test_views_are_those_of_the_capture_and_those_without_a_camera_are_counted_beside(
    kind: str, lost: int, said: str
) -> None:
    found = what_was_done(place(kind, lost), 30.0)
    assert found.startswith(said)
    assert "by a simulated eye camera at 20 electrons per green pixel, reconstructed by a, b and c, and" in found


def test_imported_photographs_are_not_said_to_be_simulated() -> None:
    found = what_was_done(place("photographs", 0, simulated=False), 30.0)
    assert found.startswith("8 dark photographs of hall (64 × 48 px) were imported, reconstructed by a, b and c, and")


def test_fits_shorter_than_published_are_said_once_for_each_length() -> None:
    def run(method: str, iterations: int) -> Any:
        return SimpleNamespace(method=method, record={"config": {"fit": {"iterations": iterations}}})

    said = "stopping early favours methods that do not denoise."
    assert short([run("naive", 2400), run("nova", 2400)]) == f"Fits took 2,400 of 7,000 iterations: {said}"
    found = short([run("naive", 2400), run("nova", 400), run("oracle", 7000)])
    assert found == f"Fits took 400 of 7,000, 2,400 of 7,000 iterations: {said}"
    assert short([run("naive", 7000), run("somebody-elses", 3)]) == ""
    assert short([SimpleNamespace(method="averaging", record={"config": {}})]) == ""  # type: ignore[list-item]
