"""Cost curves: every setting is measured, errors fall where they must."""

import pytest

from simscenes.job import curves
from simscenes.job.curves import KNOBS, Setting, render_curves

pytestmark = pytest.mark.usefixtures("jit")


def test_each_knob_has_its_default_among_its_settings() -> None:
    for knob, values in KNOBS.items():
        assert knob == "variant" or getattr(Setting(), knob) in values


def test_curves_show_the_error_fall_with_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves, "REFERENCE_ERROR", 0.03)
    monkeypatch.setattr(curves, "KNOBS", {"spp": (16, 256), "max_depth": (2, 8, 64)})
    lines = list(render_curves("cornell", size=12, repeats=2, knobs=("spp", "max_depth")))
    assert [line["setting"] for line in lines] == [16, 256, 2, 8, 64]
    assert set(lines[0]) == {"knob", "setting", "seconds", "error", "error_unit", "error_sd", "default"}
    assert all(line["seconds"] > 0 for line in lines)
    assert [line["default"] for line in lines].count(True) == 2
    noise = [line["error"] for line in lines if line["knob"] == "spp"]
    missing = [line["error"] for line in lines if line["knob"] == "max_depth"]
    assert noise[0] > 2.5 * noise[-1]  # 16 times the samples
    assert missing == sorted(missing, reverse=True)
    assert 0.02 < missing[0] < 0.2
    assert missing[-1] == 0


def test_every_knob_can_be_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves, "REFERENCE_ERROR", 0.1)
    ends = {knob: (values[0], values[-1]) for knob, values in KNOBS.items() if knob not in ("spp", "max_depth")}
    monkeypatch.setattr(curves, "KNOBS", ends | {"variant": ("scalar", "llvm_ad")})
    lines = list(render_curves("cornell", size=8, repeats=1, knobs=tuple(ends)))
    assert [line["setting"] for line in lines] == [v for values in curves.KNOBS.values() for v in values]
    assert all(line["error"] < 0.5 and line["seconds"] > 0 for line in lines)
    errors = {(line["knob"], line["setting"]): line["error"] for line in lines}
    # Paths are the same where no medium is, whichever integrator follows them, up to the random numbers it draws.
    assert errors["integrator", "path"] == pytest.approx(errors["integrator", "volpath"], abs=0.1)


def test_unknown_knobs_are_refused() -> None:
    with pytest.raises(ValueError, match="rr_depth"):
        next(render_curves(knobs=("gamma",)))
