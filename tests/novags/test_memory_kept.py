"""What a process does with memory that its arrays have freed."""

import os
import subprocess
import sys

import pytest

from novags.process import ENVIRONMENT

# What is tested is a setting of glibc's malloc (mallopt). Elsewhere novags changes nothing, so nothing can be seen.
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="mallopt is glibc's")

PROGRAM = """
import resource
{first}

def iterate():
    arrays = [b"x" * 40_000_000 for _ in range(3)]  # glibc keeps none of that by itself
    return arrays[-1][-1]

for _ in range(5):
    iterate()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    iterate()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""

SETTLED = "from novags.process import settle; settle()"


def faults(first: str, **environment: str) -> int:
    """Pages that the system had to hand out in twenty iterations."""
    mine = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(first=first)], env={**mine, **environment}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    return int(done.stdout)


def test_freed_arrays_are_used_again() -> None:
    kept, returned = faults(SETTLED), faults("")
    assert returned > 100_000
    assert kept < returned / 10


def test_a_part_that_spares_memory_returns_what_it_frees_and_nothing_changes_after_it() -> None:
    inside = f"{SETTLED}; from novags.process import sparing; part = sparing(); part.__enter__()"
    assert faults(inside) > 100_000
    after = f"{SETTLED}; from novags.process import sparing\nwith sparing(): pass"
    assert faults(after) < faults(inside) / 10
    assert faults(inside, MALLOC_MMAP_THRESHOLD_="1073741824") < 10_000  # the user's own choice holds there too


def test_a_block_that_finds_no_place_in_what_was_freed_does_not_lie_beside_it() -> None:
    program = """
import re
from novags.process import settle, sparing; settle()
with sparing({wanted}):
    maps = [b"x" * 50_000_000, b"x" * 2_000_000]
    maps[0] = None
    maps += [b"x" * 2_000_000, b"x" * 50_000_000]
    lines = open("/proc/self/status").read()
print(re.search(r"VmRSS:\\s+(\\d+)", lines)[1])
"""
    held = {}  # kB
    for wanted in (True, False):
        command = [sys.executable, "-c", program.format(wanted=wanted)]
        held[wanted] = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert held[True] < held[False] - 30_000


def test_settings_of_the_user_hold() -> None:
    assert faults(SETTLED, MALLOC_TRIM_THRESHOLD_="131072") > 10_000


def test_importing_the_packages_changes_nothing_in_the_process() -> None:
    program = (
        "import os; before = dict(os.environ); import novags, simscenes, sensor_model, novags.splats, novags.methods; "
        "print(dict(os.environ) == before)"
    )
    bare = {name: value for name, value in os.environ.items() if name not in ENVIRONMENT}
    done = subprocess.run([sys.executable, "-c", program], env=bare, capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"
    assert faults("import novags, simscenes, sensor_model") > 100_000  # nor does it keep freed memory
