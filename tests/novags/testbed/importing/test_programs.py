"""Claims about programs of somebody else: their memory, and that they end in time with all that they started."""

import os
import sys
import time
from pathlib import Path

import pytest

from novags.testbed.importing.programs import _status, run_program


def test_a_timeout_ends_the_program_and_what_it_started(tmp_path: Path) -> None:
    code = (
        "import subprocess, sys, time; c = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']);"
        "print(c.pid, flush=True); time.sleep(60)"
    )
    started = time.monotonic()
    with pytest.raises(ValueError, match=r"was ended after its timeout of 2 s: (\d+)") as error:
        run_program([sys.executable, "-c", code], tmp_path, timeout=2.0, tick=lambda seconds: None)
    assert time.monotonic() - started < 50
    child = int(str(error.value).rpartition(" ")[2])
    for _ in range(100):
        if not os.path.exists(f"/proc/{child}") or "Z" in Path(f"/proc/{child}/stat").read_text().split()[2]:
            break
        time.sleep(0.1)
    else:
        pytest.fail("the program's child lives on")


# The children of a process are read from /proc, which only Linux has; elsewhere their memory is not counted.
@pytest.mark.skipif(
    sys.platform != "linux", reason="/proc lists the children of a process; other systems have no such files"
)
def test_memory_of_children_that_another_thread_started_counts(tmp_path: Path) -> None:
    """Rationale: only those of the main thread did; data loaders and pools start theirs elsewhere."""
    child = "import time; held = bytearray(b'1') * 150_000_000; time.sleep(1)"
    code = (
        "import subprocess, sys, threading; thread = threading.Thread(target=subprocess.run, "
        f"args=([sys.executable, '-c', {child!r}],)); thread.start(); thread.join()"
    )
    assert run_program([sys.executable, "-c", code], tmp_path, timeout=60, tick=lambda _: None).peak_bytes > 150e6


def test_a_process_tells_what_it_holds_and_the_most_it_has_held() -> None:
    now, most = _status(os.getpid())
    assert 0 < now <= most
