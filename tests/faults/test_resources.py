"""What a machine may lack: the message is one line, nothing finished is lost, and the same command goes on later."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

STAGES = ("render", "capture", "reconstruct", "score", "report")
MB = 1 << 20


def one_line(result) -> str:
    """The line of a command that failed; all that it printed besides are notes of its progress."""
    assert result.code in (1, 2), result.said
    assert "Traceback" not in result.said
    assert result.line.startswith("novags: error: "), result.said
    return str(result.line)


@pytest.mark.parametrize("name", STAGES)
def test_a_full_disk_is_one_line_and_the_work_goes_on_when_there_is_room(
    name: str, server, begun: Callable[..., Path], same_as_reference: Callable[[str, Path], list[str]], stages, page
) -> None:
    folder, stage = begun(name), stages[name]
    before = sorted((folder / stage.out).rglob("*"))
    full = server.run(folder, stage.command, faults={"largest file": [2000]})
    assert page["disk full"].fullmatch(one_line(full))
    assert "File too large" in full.line or "cannot write" in full.line
    assert set(before) <= set((folder / stage.out).rglob("*"))
    assert not list(folder.rglob("*.partial*"))
    assert server.run(folder, stage.command).code == 0
    assert same_as_reference(name, folder) == []


@pytest.mark.parametrize("name", STAGES)
def test_a_folder_that_nobody_may_write_to_is_one_line(
    name: str, server, begun: Callable[..., Path], stages, page
) -> None:
    folder, stage = begun(name), stages[name]
    place = folder / stage.out if (folder / stage.out).exists() else folder
    place.chmod(0o555)
    try:
        refused = one_line(server.run(folder, stage.command, faults={"permissions": []}))
        assert page["folder that may not be written to"].fullmatch(refused)
    finally:
        place.chmod(0o755)


def test_inputs_and_finished_work_may_be_read_only(server, begun: Callable[..., Path], stages, page) -> None:
    folder = begun("report")
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        for name in ("render", "capture", "reconstruct", "score"):
            kept = server.run(folder, stages[name].command, faults={"permissions": []})
            assert kept.code == 0, kept.said
            assert page["inputs and finished work read-only"].search(kept.said)
        (folder / "run").chmod(0o755)
        again = stages["reconstruct"].command
        other = [*again[: again.index("run")], "elsewhere/run", *again[again.index("run") + 1 :], "--seed", "1"]
        folder.chmod(0o755)
        assert server.run(folder, other, faults={"permissions": []}).code == 0
    finally:
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o755)
    assert {path: path.stat().st_mtime_ns for path in before if path != folder} == {
        path: when for path, when in before.items() if path != folder
    }


def test_too_little_memory_is_one_line_and_costs_nothing(server, begun: Callable[..., Path], stages, page) -> None:
    folder, names = begun("render"), [f"{i:04d}" for i in range(3)]
    write_cameras(folder / "set", names, orbit_rig(3, 1600, 1200, 50.0, radius=3.0))
    for name in names:
        write_png(folder / "set" / "images" / f"{name}.png", np.full((1200, 1600, 3), 99, np.uint8))
    before = sorted(folder.rglob("*"))
    for command, reason in (
        (["capture", "set", "--out", "capture"], "capture: memory is not enough (Unable to allocate"),
        ([word if word != "set" else "new" for word in stages["render"].command], "render: memory is not enough ("),
    ):
        line = one_line(server.run(folder, command, faults={"memory left": [4 * MB]}))
        assert reason in line
        assert page["too little memory"].fullmatch(line)
        assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    "clock",
    [{"clock moved": [-86400]}, {"clock runs back": []}],
    ids=["set back", "runs back"],
)
def test_a_clock_that_was_set_changes_nothing(
    clock: dict, server, begun: Callable[..., Path], same_as_reference: Callable[[str, Path], list[str]], stages, page
) -> None:
    folder, stage = begun("reconstruct"), stages["reconstruct"]
    assert server.run(folder, stage.command, faults=clock).code == 0
    assert same_as_reference("reconstruct", folder) == []
    record = json.loads((folder / "run" / "run.json").read_text())
    assert min(record["stage"]["seconds"], *record["seconds"].values()) >= 0


def test_without_llvm_rendering_is_slow_and_says_so_or_refuses(
    server, begun: Callable[..., Path], stages, page
) -> None:
    folder, command = begun("render"), stages["render"].command
    asked = server.run(folder, ["llvm_ad" if w == "scalar" else w for w in command], faults={"no llvm": []})
    assert page["no libLLVM, and asked for"].fullmatch(one_line(asked))
    auto = server.run(folder, ["auto" if w == "scalar" else w for w in command], faults={"no llvm": []})
    assert auto.code == 0
    assert page["no libLLVM"].search(" ".join(auto.said.split()))


def test_missing_weights_are_one_line_or_an_unavailable_score(server, begun: Callable[..., Path], stages, page) -> None:
    folder = begun("reconstruct")
    cameras = [*stages["reconstruct"].command, "--cameras", "vggt:checkpoint=none.safetensors"]
    assert re.search(
        "package vggt, which is not installed|no VGGT weights at none", one_line(server.run(folder, cameras))
    )
    assert not (folder / "run").exists()
    metrics = json.loads((server.reference / "run" / "metrics.json").read_text())
    assert "lpips" in metrics["unavailable"] or metrics["methods"]["tiny"]["mean"]["lit"]["lpips"] is not None


def test_a_full_gpu_is_one_line_and_the_fit_goes_on_from_its_checkpoint(
    server, begun: Callable[..., Path], same_as_reference: Callable[[str, Path], list[str]], stages, page
) -> None:
    folder, command = begun("reconstruct"), stages["reconstruct"].command
    full = server.run(folder, command, faults={"gpu memory full": [15]})
    line = one_line(full)
    assert page["GPU full"].fullmatch(line)
    assert "reconstruct tiny" in line
    assert (folder / "run" / "checkpoint.denoiser.safetensors").exists()
    assert server.run(folder, command, faults={"gpu memory full": [10]}).code == 0  # ten iterations were kept
    assert same_as_reference("reconstruct", folder) == []
