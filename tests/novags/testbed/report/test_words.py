"""Claims about numbers in words."""

from novags.testbed.report.words import duration, join, number, signed, size


def test_words_for_numbers() -> None:
    assert [duration(s) for s in (0.04, 9.9, 59.6, 119.0, 150.0, 7260.0)] == [
        "0.0 s", "9.9 s", "60 s", "119 s", "2 min 30 s", "2 h 01 min",
    ]  # fmt: skip
    assert [size(b) for b in (5e5, 2.5e9)] == ["0 MB", "2.5 GB"]
    assert [join(w) for w in (["a"], ["a", "b"], ["a", "b", "c"])] == ["a", "a and b", "a, b and c"]
    assert [number(v) for v in (1.234, None, "inf")] == ["1.23", "unavailable", "inf"]
    assert [signed(v) for v in (1.0, -0.5)] == ["+1.00", "−0.50"]
