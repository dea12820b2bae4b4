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
import torch

def iterate():
    arrays = [torch.ones(10_000_000) for _ in range(3)]  # 40 MB each: glibc keeps none of that by itself
    return float(sum(arrays)[-1])

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
