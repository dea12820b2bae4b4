"""Where machine code is kept between runs: found by every copy of the same sources, never by other ones."""

import importlib.util
import os
import shutil
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sensor_model.fast import machine_code
from sensor_model.fast.machine_code import compiled, digest_of, folder_for

SOURCE = '''"""A module with a kernel."""

import numpy as np

FACTOR = np.float64(3.0)


def scale(values):
    """Multiply values in place; returns their sum."""
    total = 0.0
    for i in range(len(values)):
        values[i] *= FACTOR
        total += values[i]
    return total
'''
EDITS = {
    "nothing": ("", ""),
    "a docstring": ("Multiply values in place", "Values times a factor, in place,\n    one by one"),
    "a comment, so that lines move": ("FACTOR =", "# How much.\n\nFACTOR ="),
    "a constant": ("3.0", "4.0"),
    "the order of two statements": (
        "        values[i] *= FACTOR\n        total += values[i]\n",
        "        total += values[i]\n        values[i] *= FACTOR\n",
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test alone."""
    from numba import config

    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    machine_code._own.cache_clear()
    return tmp_path


def module(folder: Path, source: str) -> ModuleType:
    folder.mkdir(parents=True)
    (folder / "scaling.py").write_text(source)
    spec = importlib.util.spec_from_file_location("scaling", folder / "scaling.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.mark.parametrize("edit", EDITS)
def test_a_second_clone_finds_the_code_unless_it_does_something_else(home: Path, edit: str) -> None:
    values, hits, folders = np.array([1.0, 2.0]), [], []
    for clone, source in (("first", SOURCE), ("second", SOURCE.replace(*EDITS[edit]))):
        source_of = module(home / clone / "package", source)
        folder = folder_for([home / clone / "package" / "scaling.py"])
        scale = compiled(source_of.scale, folder, nogil=True)
        expected = source_of.scale(values.copy())
        assert scale(values.copy()) == expected
        hits.append(sum(scale.stats.cache_hits.values()))
        folders.append(folder)
    same = edit not in ("a constant", "the order of two statements")
    assert hits == [0, int(same)]
    assert (folders[0] == folders[1]) == same


def test_a_kernel_whose_source_is_not_one_of_the_folder_is_compiled_anew_when_it_changes(home: Path) -> None:
    """Its folder stays the same: code of what a method adds to the kernels that it calls."""
    folder = folder_for([])
    for clone, source, factor in (("a", SOURCE, 3), ("b", SOURCE.replace("3.0", "5.0"), 5)):
        scale = compiled(module(home / clone, source).scale, folder)
        assert scale(np.ones(2)) == 2 * factor
        assert sum(scale.stats.cache_hits.values()) == 0


def test_the_digest_is_of_every_source(home: Path) -> None:
    paths = [home / name for name in ("a.py", "b.py", "c.py")]
    for path in paths:
        path.write_text(f"NAME = {path.stem!r}\n")
    before = digest_of(paths)
    for path in paths:
        text = path.read_text()
        path.write_text(text.replace("NAME", "OTHER"))
        assert digest_of(paths) != before
        path.write_text(text)
    assert digest_of(paths) == before
    assert digest_of(paths[::-1]) != before


@pytest.mark.parametrize("name", ["cpu/vectors/simd.py", "cpu/raster/record.py", "sh.py"])
def test_a_change_of_anything_that_the_splat_kernels_are_made_of_gives_another_folder(
    home: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    from novags.splats import sh
    from novags.splats.cpu import compiler

    package = Path(sh.__file__).parent
    for path in package.rglob("*.py"):
        copy = home / "splats" / path.relative_to(package)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    here = compiler.cache_folder()
    monkeypatch.setattr(compiler, "__file__", str(home / "splats" / "cpu" / "compiler.py"))
    copied = compiler.cache_folder()
    changed = home / "splats" / name
    changed.write_text(changed.read_text() + "\n# changed\n")
    assert compiler.cache_folder() == copied
    changed.write_text(changed.read_text() + "\nCHANGED = 1\n")
    after = compiler.cache_folder()
    assert after != copied
    assert here is not None
    assert after is not None
    assert after.parent == here.parent


def test_folders_of_other_sources_go_when_unused_for_a_month() -> None:
    used = folder_for([])
    assert used is not None
    names = (f"kernels-{'0' * 16}", f"kernels-{'1' * 16}", "kernels-backup")
    old, recent, other = (used.parent / name for name in names)
    for folder in (used, old, recent, other):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "code.nbc").write_bytes(b"")
    month_ago = time.time() - 31 * 86400
    for folder in (used, old, other):
        os.utime(folder, (month_ago, month_ago))
    assert folder_for([]) == used
    assert used.exists()
    assert used.stat().st_mtime > month_ago + 86400  # marked as used
    assert not old.exists()
    assert recent.exists()
    assert other.exists()


def test_machine_code_that_others_could_have_written_is_not_run(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: it is loaded and run; in a NUMBA_CACHE_DIR that many share, anybody could make the folder first."""
    from numba import config

    monkeypatch.setattr(config, "CACHE_DIR", str(home / "shared"))
    folder = folder_for([])
    assert folder is not None
    assert folder.parent == home / "shared"
    (folder / "code.nbc").write_bytes(b"theirs")
    folder.chmod(0o777)
    assert folder_for([]) == folder
    assert list(folder.iterdir()) == []
    folder.rmdir()
    folder.symlink_to(home)
    assert folder_for([]) is None


def test_without_a_folder_kernels_run_and_nothing_is_kept(home: Path) -> None:
    scale = compiled(module(home / "a", SOURCE).scale, None)
    assert scale(np.ones(2)) == 6
    assert not list(home.rglob("*.nbc"))
