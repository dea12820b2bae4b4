"""Help, lists and typing errors load none of the heavy libraries."""

import subprocess
import sys

import pytest

from novags import cli


def test_help_loads_no_heavy_library() -> None:
    code = (
        "import sys; sys.argv = ['novags', '--help']\n"
        "from novags.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('HEAVY', sorted({'torch', 'mitsuba', 'numba', 'cv2', 'scipy', 'matplotlib'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "HEAVY []" in done.stdout
    assert all(command in done.stdout for command in cli.COMMANDS)


@pytest.mark.parametrize("words", [["list"], ["run", "--methods", "magic"]], ids=" ".join)
def test_lists_and_typing_errors_do_not_wait_for_torch(words: list[str]) -> None:
    code = (
        f"import sys; sys.argv = {['novags', *words]}\n"
        "from novags.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('HEAVY', sorted({'torch', 'mitsuba', 'numba'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "HEAVY []" in done.stdout
    assert words == ["list"] or "novags: error: " in done.stderr
