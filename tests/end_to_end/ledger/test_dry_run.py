"""Claims about --dry-run: every command that makes something says what it would do, and writes nothing."""

from collections.abc import Callable
from pathlib import Path

import pytest

SMALL = ("--views", "4", "--width", "24", "--height", "24", "--spp", "4")
SHORT = ("--points", "60", "--iterations", "5", "--device", "cpu")


def tree(folder: Path) -> dict[str, int]:
    """Files: locks come and go in folders."""
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_every_stage_can_be_asked_before_it_is_done(
    tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    ball_xml: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(ball_xml)
    lines = (
        ("render", "ball.xml", "--out", "set", "--variant", "scalar", *SMALL),
        ("capture", "set", "--out", "capture"),
        ("reconstruct", "capture", "--method", "naive", "--out", "run", *SHORT),
        ("score", "run"),
        ("denoise", "capture", "--out", "clean", "--no-adapt", "--turns", "1"),
    )
    for words in lines:
        for expected in ("to be made in", "unchanged, kept"):
            before = tree(tmp_path)
            assert call(*words, "--dry-run") == 0
            said = capsys.readouterr()
            assert expected in said.err
            assert "next:" not in said.err
            assert tree(tmp_path) == before
            assert call(*words) == 0
            capsys.readouterr()
        assert tree(tmp_path).keys() >= before.keys()


def test_a_run_says_of_every_part_what_it_would_do(
    tmp_path: Path, call: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    ball_xml: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(ball_xml)
    words = ("run", "--scene", "ball.xml", "--out", "all", "--methods", "naive", *SMALL, *SHORT)
    assert call(*words, "--dry-run") == 0
    said = capsys.readouterr().err
    assert [line.split(":")[0] for line in said.splitlines()] == ["render", "capture", "naive"]
    assert not Path("all").exists()
    assert call(*words) == 0
    capsys.readouterr()
    before = tree(tmp_path)
    assert call(*words[:7], "oracle", *words[7:], "--dry-run") == 0
    said = capsys.readouterr().err
    assert said.count("unchanged, kept") == 3
    assert "reconstruct oracle: to be made in all/oracle" in said
    assert tree(tmp_path) == before
    assert call(*words, "--budget", "60s", "--dry-run") != 0
    assert "--dry-run does not go with --budget" in capsys.readouterr().err
