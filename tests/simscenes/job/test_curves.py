"""Cost curves: every setting is measured, errors fall where they must."""

import pytest

from simscenes.job import curves
from simscenes.job.curves import KNOBS, SceneBench, Setting, settings_of

pytestmark = pytest.mark.usefixtures("jit")


def test_each_knob_has_its_default_among_its_settings() -> None:
    for knob, values in KNOBS.items():
        assert knob == "variant" or getattr(Setting(), knob) in values


def test_curves_show_the_error_fall_with_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves, "REFERENCE_ERROR", 0.03)
    bench = SceneBench("cornell", 12)
    noise = [bench.measure("spp", spp, 0) for spp in (16, 256)]
    missing = [bench.measure("max_depth", depth, 0).error for depth in (2, 8, 64)]
    assert all(found.seconds > 0 and found.cpu_seconds > 0 for found in noise)
    assert noise[0].error > 2.5 * noise[-1].error  # 16 times the samples
    assert missing == sorted(missing, reverse=True)
    assert 0.02 < missing[0] < 0.2
    assert missing[-1] == 0


def test_every_knob_can_be_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves, "REFERENCE_ERROR", 0.1)
    ends = {knob: (values[0], values[-1]) for knob, values in KNOBS.items() if knob not in ("spp", "max_depth")}
    bench, errors = SceneBench("cornell", 8), {}
    for knob, values in (ends | {"variant": ("scalar", "llvm_ad")}).items():
        for value in values:
            found = bench.measure(knob, value, 0)
            assert found.error < 0.5
            assert found.seconds > 0
            errors[knob, value] = found.error
    # Paths are the same where no medium is, whichever integrator follows them, up to the random numbers it draws.
    assert errors["integrator", "path"] == pytest.approx(errors["integrator", "volpath"], abs=0.1)


def test_unknown_knobs_are_refused() -> None:
    with pytest.raises(ValueError, match="rr_depth"):
        settings_of("gamma")
