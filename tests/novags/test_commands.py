"""Claims about single commands: options that belong together are taken together, or refused in one line."""

from collections.abc import Callable
from pathlib import Path

import pytest

Call = Callable[..., int]


def test_one_method_is_reconstructed_and_it_is_the_one_that_is_named(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Rationale: the first variant of a file was taken whatever --method said."""
    from novags.testbed import stages

    seen = []
    monkeypatch.setattr(stages, "reconstruct", lambda _, __, config, *___, **____: seen.append(config.variant.name))
    (tmp_path / "two.toml").write_text('[variant.x]\nmethod = "naive"\n[variant.y]\nmethod = "naive"\n')
    two, one = ("--variant", str(tmp_path / "two.toml")), ("--variant", "l1=naive:fit.dssim_weight=0")
    words = ("reconstruct", str(tmp_path), "--out", str(tmp_path / "run"))
    for named in ((), ("--method", "naive"), one, (*one, "--method", "l1"), (*two, "--method", "y")):
        assert call(*words, *named) == 0
    assert seen == ["nova-fast", "naive", "l1", "l1", "y"]
    for named, why in ((two, "defines x, y, more than one"), ((*one, "--method", "naive"), "but --method is naive")):
        capsys.readouterr()
        assert call(*words, *named) == 2
        assert why in capsys.readouterr().err
    assert len(seen) == 5


def test_a_reference_is_refused_where_it_would_choose_nothing(
    call: Call, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert call("score", str(tmp_path), "--reference", "linear") == 2
    assert "--reference linear belongs to --renders" in capsys.readouterr().err


@pytest.mark.parametrize(("level", "said"), [("mvtv", True), ("lom", False)])
def test_after_a_capture_at_a_level_of_16_bits_the_next_command_takes_them(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, level: str,
    said: bool,
) -> None:  # fmt: skip
    """Rationale: without a word the next step took its 8-bit pictures, which are nearly black."""
    from novags.testbed import stages

    monkeypatch.setattr(stages, "capture", lambda *_, **__: {})
    assert call("capture", str(tmp_path), "--level", level, "--out", str(tmp_path / "cap")) == 0
    assert ("--pictures 16bit" in capsys.readouterr().err) == said


def test_doctor_says_where_kernels_are_kept_when_the_package_may_not_be_written_to(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Rationale: it said that they are compiled anew each time."""
    from novags.commands.answers import doctor

    home = str(tmp_path)
    monkeypatch.setattr("os.access", lambda place, _: str(place).startswith(home))
    monkeypatch.setenv("XDG_CACHE_HOME", home)
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    finding = doctor._kernels()
    assert (finding.state, finding.detail.endswith(str(tmp_path / "novags"))) == ("ok", True)
    monkeypatch.setattr("os.access", lambda *_: False)
    assert doctor._kernels().state == "missing"
