"""Claims about limits of control groups: those of this process's own group and of all above it count."""

import os
from pathlib import Path

import pytest

from novags.testbed.console import groups
from novags.testbed.console.cores import cores_here
from novags.testbed.console.memory import available_bytes

MB = 1 << 20
V1 = "9:name=systemd:/\n4:memory:/slurm/job_7\n2:cpu,cpuacct:/slurm/job_7\n0::/\n"


def memory(folder: str, limit: str, used: int = 10 * MB, spare: int = 4 * MB, first: bool = False) -> dict[str, str]:
    """Files of a group's memory, of version 1 if `first`."""
    names = (
        ("limit_in_bytes", "usage_in_bytes", "total_inactive_file") if first else ("max", "current", "inactive_file")
    )
    return {f"{folder}memory.{names[0]}": f"{limit}\n", f"{folder}memory.{names[1]}": f"{used}\n",
            f"{folder}memory.stat": f"anon 5\n{names[2]} {spare}\n"}  # fmt: skip


TREES = {
    "a limit in a child": ("0::/system.slice/job.scope\n", memory("system.slice/job.scope/", str(50 * MB)), 44),
    "a lower one above it": (
        "0::/job/step\n", {**memory("job/", str(30 * MB)), **memory("job/step/", str(50 * MB))}, 24,
    ),
    "none but above it": ("0::/job/step\n", {**memory("job/", str(30 * MB)), **memory("job/step/", "max")}, 24),
    "version 1": (V1, memory("memory/slurm/job_7/", str(50 * MB), first=True), 44),
    "a container that sees its own as the root": ("0::/docker/1f\n", memory("", str(50 * MB)), 44),
    "no list of groups": (None, memory("memory/", str(50 * MB), first=True), 44),
    "somebody else's": ("0::/mine\n", memory("other/", str(50 * MB)), None),
}  # fmt: skip


def put(files: dict[str, str], member: str | None, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    if member is not None:
        (folder / "member").write_text(member)
    monkeypatch.setattr(groups, "ROOT", folder)
    monkeypatch.setattr(groups, "MEMBERSHIP", folder / "member")


@pytest.mark.parametrize("what", TREES)
def test_the_memory_is_what_the_lowest_limit_leaves(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    member, files, left = TREES[what]
    put(files, member, tmp_path, monkeypatch)
    found = available_bytes()
    assert found == left * MB if left is not None else found > 50 * MB


@pytest.mark.parametrize("place", range(3))
def test_the_system_and_its_groups_may_list_their_memory_in_any_order(
    place: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def put_among(others: list[str], line: str) -> str:
        return "\n".join([*others[:place], line, *others[place:]]) + "\n"

    files = memory("job/", str(50 * MB))
    files["job/memory.stat"] = put_among(["anon 5", "file 6"], f"inactive_file {4 * MB}")
    put(files, "0::/job\n", tmp_path, monkeypatch)
    monkeypatch.setattr("novags.testbed.console.memory.MEMINFO", tmp_path / "meminfo")
    for free, left in ((90, 44), (30, 30)):
        text = put_among(["MemTotal: 7 kB", "MemFree: 8 kB"], f"MemAvailable: {free * MB // 1024} kB")
        (tmp_path / "meminfo").write_text(text)
        assert available_bytes() == left * MB


@pytest.mark.parametrize(
    ("member", "files", "count"),
    [
        ("0::/job/step\n", {"job/cpu.max": "250000 100000\n", "job/step/cpu.max": "max 100000\n"}, 3),
        ("0::/job/step\n", {"job/cpu.max": "250000 100000\n", "job/step/cpu.max": "150000 100000\n"}, 2),
        (V1, {"cpu/slurm/job_7/cpu.cfs_quota_us": "300000\n", "cpu/slurm/job_7/cpu.cfs_period_us": "100000\n"}, 3),
        ("0::/job\n", {"other/cpu.max": "100000 100000\n"}, 8),
    ],
)
def test_the_cores_are_those_of_the_lowest_limit(
    member: str, files: dict[str, str], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(files, member, tmp_path, monkeypatch)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)), raising=False)
    assert cores_here() == count
