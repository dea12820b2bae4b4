"""Where machine code is kept between runs: never that of other sources, and not for ever."""

import os
import shutil
import time
from pathlib import Path

import pytest

from novags.splats import sh
from novags.splats.cpu import compiler


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A copy of the package's sources that the compiler takes for its own."""
    package = Path(sh.__file__).parent
    for path in package.rglob("*.py"):
        copy = tmp_path / path.relative_to(package)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    monkeypatch.setattr(compiler.config, "CACHE_DIR", "")
    monkeypatch.setattr(compiler, "__file__", str(tmp_path / "cpu" / "compiler.py"))
    return tmp_path


@pytest.mark.parametrize("name", ["cpu/vectors/simd.py", "cpu/raster/record.py", "sh.py"])
def test_a_change_of_anything_that_kernels_are_made_of_gives_another_folder(sources, name):
    before = compiler.cache_folder()
    (sources / name).write_text((sources / name).read_text() + "\n# changed\n")
    after = compiler.cache_folder()
    assert after != before
    assert after.parent == before.parent


def test_folders_of_other_sources_go_when_unused_for_a_month(sources):
    used = compiler.cache_folder()
    names = (f"kernels-{'0' * 16}", f"kernels-{'1' * 16}", "kernels-backup")
    old, recent, other = (used.parent / name for name in names)
    for folder in (used, old, recent, other):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "code.nbc").write_bytes(b"")
    month_ago = time.time() - 31 * 86400
    for folder in (used, old, other):
        os.utime(folder, (month_ago, month_ago))
    assert compiler.cache_folder() == used
    assert used.exists()
    assert used.stat().st_mtime > month_ago + 86400  # marked as used
    assert not old.exists()
    assert recent.exists()
    assert other.exists()


def test_machine_code_that_others_could_have_written_is_not_run(sources, monkeypatch):
    """Rationale: it is loaded and run; in a NUMBA_CACHE_DIR that many share, anybody could make the folder first."""
    monkeypatch.setattr(compiler.config, "CACHE_DIR", str(sources / "shared"))
    folder = compiler.cache_folder()
    assert folder.parent == sources / "shared"
    (folder / "code.nbc").write_bytes(b"theirs")
    folder.chmod(0o777)
    assert compiler.cache_folder() == folder
    assert list(folder.iterdir()) == []
    folder.rmdir()
    folder.symlink_to(sources)
    assert compiler.cache_folder() is None
