"""The choice of a Mitsuba variant never takes the process down."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sensor_model.files.python import python
from simscenes import backend, orbit_rig, plan_transport, render_set


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[pytest.MonkeyPatch]:
    """No remembered probes, neither in memory nor on disk, before and after."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cached = (backend._working_llvm, backend._working_cuda)
    for function in cached:
        function.cache_clear()
    yield monkeypatch
    for function in cached:
        function.cache_clear()


def test_importing_simscenes_imports_no_mitsuba() -> None:
    code = "import sys, simscenes, simscenes.sets.multiview; print({'mitsuba', 'drjit', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_without_any_llvm_rendering_falls_back_to_scalar_and_says_what_helps(fresh: pytest.MonkeyPatch) -> None:
    fresh.setattr(backend, "llvm_candidates", lambda: [])
    fresh.setattr(backend, "_working_cuda", lambda: (False, "no driver"))
    with pytest.warns(UserWarning, match="libllvm19"):
        assert backend.choose_variant() == "scalar_rgb"
    with pytest.raises(ValueError, match="libllvm19"):
        backend.choose_variant("llvm_ad")


def test_versions_that_abort_are_not_even_tried(fresh: pytest.MonkeyPatch, tmp_path: Path) -> None:
    old = [tmp_path / "libLLVM-15.so.1", tmp_path / "libLLVM-14.so.1"]
    for library in old:
        library.touch()
    fresh.setattr(backend, "llvm_candidates", lambda: old)
    fresh.setattr(backend, "_run_probe", lambda *_: pytest.fail("an old library was loaded"))
    library, reason = backend._working_llvm()
    assert library is None
    assert "libLLVM-15.so.1 is too old" in reason


def test_a_library_that_aborts_costs_a_subprocess_and_nothing_else(fresh: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bad = tmp_path / "libLLVM-99.so"
    bad.touch()
    fresh.setattr(backend, "llvm_candidates", lambda: [bad])
    fresh.setattr(backend, "_PROBE", "import os; os.abort()")
    library, reason = backend._working_llvm()
    assert library is None
    assert "aborts the process" in reason


def test_a_missing_library_named_by_the_user_is_passed_over(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM-19.so")
    assert backend.llvm_candidates()[0] == Path("/nowhere/libLLVM-19.so")
    fresh.setattr(backend, "_PLACES", ())
    assert backend._working_llvm()[1].startswith("/nowhere/libLLVM-19.so does not exist; ")


def test_success_is_remembered_on_disk_and_failure_is_not(fresh: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    answers = iter(["broken", "", "unused"])

    def probe(variant: str, library: Path | None) -> str:
        calls.append(variant)
        return next(answers)

    fresh.setattr(backend, "_run_probe", probe)
    assert backend._probe("llvm_ad_rgb", None, "s") == "broken"
    assert backend._probe("llvm_ad_rgb", None, "s") == ""
    assert backend._probe("llvm_ad_rgb", None, "s") == ""
    assert len(calls) == 2
    assert backend._probe("llvm_ad_rgb", None, "another library") == "unused"


def test_newest_library_comes_first(fresh: pytest.MonkeyPatch) -> None:
    fresh.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    names = ["/x/libLLVM-9.so", "/x/libLLVM-14.so.1", "/x/libLLVM.so.19.1", "/x/libLLVM.so.20.1"]
    fresh.setattr(backend.glob, "glob", lambda pattern: names)
    fresh.setattr(backend.os.path, "realpath", lambda path: path)
    assert [p.name for p in backend.llvm_candidates()] == [
        "libLLVM.so.20.1", "libLLVM.so.19.1", "libLLVM-14.so.1", "libLLVM-9.so"
    ]  # fmt: skip


def test_report_covers_every_variant_and_explains_each_that_fails() -> None:
    report = backend.variant_report()
    assert [r.variant for r in report] == [f"{b}_{c}" for b in backend.BACKENDS for c in backend.COLORS]
    assert all(r.reason for r in report)
    assert report[-1].works


@pytest.mark.parametrize("arguments", [("metal",), ("auto", "infrared"), ("llvm_rgb",)])
def test_unknown_variants_are_refused(arguments: tuple) -> None:
    with pytest.raises(ValueError, match="must be"):
        backend.choose_variant(*arguments)


def fail_in_spectra() -> None:
    with backend.using_variant("scalar", "spectral") as mi:
        raise RuntimeError(f"in {mi.variant()}")


def test_a_variant_in_use_gives_way_to_the_one_before_also_after_an_error() -> None:
    mi = backend.activate()
    outer = mi.variant()
    with backend.using_variant("scalar") as scalar:
        assert (scalar.variant(), backend.backend_of()) == ("scalar_rgb", backend.backend_of(outer))
        with pytest.raises(RuntimeError, match="in scalar_spectral"):
            fail_in_spectra()
        assert mi.variant() == "scalar_rgb"
    assert mi.variant() == outer
    with pytest.raises(ValueError, match="must be"), backend.using_variant("metal"):
        pass
    assert mi.variant() == outer


def test_where_no_variant_was_set_before_one_in_use_stays() -> None:
    code = """
from simscenes.backend import using_variant
with using_variant("scalar") as mi:
    pass
print(mi.variant())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "scalar_rgb"


def test_rendering_and_planning_leave_the_callers_variant_set(tmp_path: Path) -> None:
    with backend.using_variant("scalar", "spectral") as mi:
        scene = {"type": "scene", "ball": {"type": "sphere"}, "sky": {"type": "constant"}}
        rig = orbit_rig(2, 8, 8, 40, radius=4.0)
        render_set(scene, rig, tmp_path, spp=2, plan="rgb", variant="scalar")
        assert mi.variant() == "scalar_spectral"
        plan_transport(scene, 0.5, rig=rig, variant="scalar", measure=False)
        assert mi.variant() == "scalar_spectral"


def test_the_backend_of_any_variant_is_known() -> None:
    assert backend.backend_of("scalar_spectral") == "scalar"
    assert backend.backend_of("auto") == backend.choose_variant().removesuffix("_rgb")


@pytest.mark.usefixtures("jit")
def test_many_changes_of_variants_say_nothing(
    recwarn: pytest.WarningsRecorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scenes in spectra change twice a view; Dr.Jit would tell the user to change his program."""
    with backend.using_variant("scalar"):
        monkeypatch.setattr("drjit.ast._syntax_counter", 1000)
        with backend.using_variant("auto", "spectral"):
            pass
    assert not recwarn.list


EXR = """
import os, sys
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np
from simscenes.backend import activate
mi = activate("scalar")
mi.Bitmap(np.ones((8, 8, 3), np.float32)).write(sys.argv[1])
sky = mi.load_dict({"type": "scene", "sky": {"type": "envmap", "filename": sys.argv[1]}})
print(len(sky.emitters()))
"""


def test_openexr_is_read_and_written_on_a_machine_with_one_core(tmp_path: Path) -> None:
    """Rationale: Mitsuba's own threads waited for ever there, in tests of its plugins and wherever a sky was a file."""
    done = subprocess.run(python(EXR, str(tmp_path / "sky.exr")), capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout.strip()) == (0, "1"), done.stderr
