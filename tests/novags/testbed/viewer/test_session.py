"""Claims about one browser's session that need no browser."""

from types import SimpleNamespace

import pytest

from novags.testbed.viewer.session import Session


def test_what_cannot_be_exposed_is_said_and_hides_no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A black model has no light to expose, but its pictures must stay visible: they show what went wrong."""
    done: list[str] = []

    def black(_: Session) -> None:
        raise ValueError("the light is black")

    for step in ("_enter", "_offer", "_show_splats", "_show_pictures", "_clear_the_view"):
        monkeypatch.setattr(Session, step, lambda _, step=step: done.append(step))
    monkeypatch.setattr(Session, "_show_light", black)
    monkeypatch.setattr(Session, "_say", lambda _, trouble: done.append(trouble))
    session = object.__new__(Session)
    session.latest, session.has_gaussians = SimpleNamespace(over=False), True  # type: ignore[assignment]
    session._update(frozenset({"capture"}))
    said = "**ValueError**: the light is black"
    assert done == ["_enter", "_offer", "_show_splats", "_show_pictures", "_clear_the_view", said]
