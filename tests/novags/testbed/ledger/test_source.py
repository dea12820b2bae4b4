"""Claims about what counts in a file of source, and what it reaches."""

import io
import sys
import tokenize
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from novags.testbed.ledger.source import read, significant, sources

SOURCE = b'''"""What this is."""

import os
from pkg.part import name

LIMIT = 3  # px


def halved(value: int) -> float:
    """Half of it."""
    if value > LIMIT:
        raise ValueError(f"value must be <= {LIMIT}, got {value!r:>8}")
    return value / 2
'''


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b'"""What this is."""', b'"""What that was, in\ntwo lines."""'),
        (b'    """Half of it."""\n', b""),
        (b"  # px", b""),
        (b"  # px", b"  # millimetres"),
        (b"\n\n\ndef", b"\ndef"),
        (b"import os\n", b"import   os\n\n\n"),
        (b"value must be", b"the value must be"),
        (b"got {value!r:>8}", b"got {value}"),
        (b"    if value > LIMIT:\n        raise", b"    if value > LIMIT:\n            raise"),
    ],
)
def test_texts_and_layout_do_not_count(before: bytes, after: bytes) -> None:
    assert before in SOURCE
    assert read(SOURCE.replace(before, after)) == read(SOURCE)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"LIMIT = 3", b"LIMIT = 4"),
        (b"value / 2", b"value // 2"),
        (b"value > LIMIT", b"value >= LIMIT"),
        (b"ValueError", b"TypeError"),
        (b"    return value / 2", b"        return value / 2"),
        (b"value: int)", b"value: int = 1)"),
        (b"import os\n", b"import sys\n"),
        (b"LIMIT = 3", b"LIMIT = '3'"),
        (b"return value / 2", b"return f'{value / 2}'"),
        (b"return value / 2", b"return f'{value / 3}'"),
    ],
)
def test_what_can_change_a_value_counts(before: bytes, after: bytes) -> None:
    assert before in SOURCE
    assert read(SOURCE.replace(before, after)) != read(SOURCE)


def test_changes_inside_a_formatted_string_count() -> None:
    texts = (b"a{b}", b"a{c}", b"a{b:.2f}", b"A{b}", b"a{b}'f'")
    assert len({read(b"x = f'%s'\n" % text).definitions[0].tokens for text in texts}) == 5


def test_rows_of_a_table_neither_count_nor_lead_anywhere_but_named_functions_do() -> None:
    table = b"from pkg import Registry\nROWS: dict = Registry({'a': 'pkg.a:ROW'})\nBEST = 'a'\n"
    assert read(table) == read(table.replace(b"}", b", 'b': 'pkg.b:ROW'}"))
    more = table + b"BOTH = Registry({'c': 'pkg.c:ROW'}), Registry({'d': 'pkg.d:ROW'})\n"
    assert read(table) != read(more) == read(more.replace(b"'c'", b"'e'")) == read(more.replace(b"'d'", b"'f'"))
    assert read(table) != read(table.replace(b"BEST = 'a'", b"BEST = 'b'"))
    assert [(one.uses, one.reaches) for one in read(table).definitions] == [(("ROWS", "Registry"), ()), (("BEST",), ())]
    assert read(b"train = Later('pkg.a:train')\n").definitions[0].reaches == (("pkg.a", "train"),)


def test_imports_are_found_wherever_they_stand_but_for_type_checkers() -> None:
    source = read(
        b"import pkg.one\nimport pkg.six as six\nfrom .two import a, b as c\n"
        b"if TYPE_CHECKING:\n    from pkg.three import d\nelse:\n    import pkg.four\n"
        b"def f():\n    from .. import five\n"
    )
    assert source.imports == {"pkg": ("pkg", ""), "six": ("pkg.six", ""), "a": (".two", "a"), "c": (".two", "b")}
    assert source.loads == (("pkg.one", ""), ("pkg.six", ""), (".two", "a"), (".two", "b"))
    condition, function = source.definitions
    assert (condition.runs, condition.reaches) == (True, (("pkg.four", ""),))
    assert (function.runs, function.reaches) == (False, (("..", "five"),))


@pytest.mark.parametrize(
    ("text", "names", "runs", "uses"),
    [
        ("def f(a=X):\n    b = np.sum(a)\n    return g(b)", ("f",), False, ("X", "g", "np.sum")),
        ("@np.cache\nclass A(B):\n    x: C = X", ("A",), False, ("B", "C", "X", "np.cache")),
        ("@X(Y)\nclass A: pass", ("A",), True, ("X", "Y")),
        ("@np.cache\n@X.register\ndef f(): pass", ("f",), True, ("X.register", "np.cache")),
        ("X = Y = g(Z)", ("X", "Y"), False, ("X", "Y", "Z", "g")),
        ("A, *B = Z", ("A", "B"), True, ("A", "B", "Z")),
        ("X[0] = Y", (), True, ("X", "Y")),
        ("X.a.b = Y", (), True, ("X.a.b", "Y")),
        ("X += Y", ("X",), True, ("X", "Y")),
        ("for _i in Z:\n    A = g(_i)", ("A", "_i"), True, ("A", "Z", "_i", "g")),
        ("g(X)", (), True, ("X", "g")),
        ("if Z:\n    import X\n    def B(): pass", ("B", "X"), True, ("Z",)),
        ("def f():\n    global X\n    X = Y", ("X", "f"), False, ("X", "Y")),
        ("__name__ == '__main__'", (), True, ()),
    ],
)
def test_a_statement_binds_names_and_may_do_more(text: str, names: tuple[str, ...], runs: bool, uses: tuple) -> None:
    known = b"import numpy as np\nA = B = C = X = Y = Z = g = 0\n"
    found = read(known + text.encode()).definitions[-1]
    assert (found.names, found.runs, found.uses) == (names, runs, uses)


def test_formatted_strings_are_one_token_however_python_takes_them_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: from Python 3.12 on they are several, and a store is shared by machines with different versions."""
    content = b'a = f\'{x}-{y:>{w}}\' + rf\'\\d\' f"""{z}\nb"""\n'
    expected = read(content).definitions[0].tokens
    real = tokenize.tokenize
    start, middle, end = 1001, 1002, 1003  # numbers that no kind of this version has

    def apart(readline: Callable[[], bytes]) -> Iterator[tokenize.TokenInfo]:
        """The tokens of Python 3.12, near enough: a formatted string begins, has parts, and ends."""
        for token in real(readline):
            if token.type != tokenize.STRING or "f" not in token.string[:2]:
                yield token
                continue
            yield token._replace(type=start, end=(token.start[0], token.start[1] + 2))
            yield token._replace(type=middle)
            yield token._replace(type=tokenize.NAME, string="x")
            yield token._replace(type=end, start=(token.end[0], token.end[1] - 1))

    if sys.version_info < (3, 12):  # there it is done by Python itself, and the hash above is the same
        for name, number in (("START", start), ("MIDDLE", middle), ("END", end)):
            monkeypatch.setattr(tokenize, f"FSTRING_{name}", number, raising=False)
        monkeypatch.setattr(tokenize, "tokenize", apart)
    assert read(content).definitions[0].tokens == expected == "ff3e8cb3a8dbabe86b72bafae3ac826d"


def test_a_source_that_was_read_is_remembered_and_read_again_after_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    sources.cache_clear()
    try:
        first = sources().of(SOURCE)
        sources().remember()
        sources.cache_clear()
        monkeypatch.setattr("novags.testbed.ledger.source.read", lambda content: pytest.fail("read again"))
        assert sources().of(SOURCE) == first
        with pytest.raises(pytest.fail.Exception):
            sources().of(SOURCE + b"\n")
    finally:
        sources.cache_clear()


def test_a_memory_that_was_damaged_costs_nothing_but_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    sources.cache_clear()
    try:
        first = sources().of(SOURCE)
        sources().remember()
        (file,) = (tmp_path / "novags" / "sources").iterdir()
        for text in ("", "[]", '{"a": 1}', file.read_text()[:-9]):
            file.write_text(text)
            sources.cache_clear()
            assert sources().of(SOURCE) == first
    finally:
        sources.cache_clear()


def test_tokens_are_those_of_the_standard_library(tmp_path: Path) -> None:
    """The hash is of Python's own tokens: here those of a source without strings, comments and errors."""
    content = b"def f(a, b=2):\n    return a ** b\n\n\nX = f(3)\n"
    kinds = {tokenize.INDENT: ">", tokenize.DEDENT: "<", tokenize.NEWLINE: ";"}
    skipped = (tokenize.ENCODING, tokenize.NL, tokenize.ENDMARKER)
    expected = [kinds.get(t.type, t.string) for t in tokenize.tokenize(io.BytesIO(content).readline)
                if t.type not in skipped]  # fmt: skip
    assert list(significant(content)) == expected


def test_all_names_of_a_statement_count_whichever_of_them_is_used() -> None:
    text = b"""
import one, two.part, three as third
from pkg import four, five as fifth


def change():
    global A, B
    A, B = one.x, two.part.y
    import six, seven
    from pkg.deep import eight, nine
    return third, four, fifth
"""
    (change,), imports = (found := read(text)).definitions, found.imports
    assert change.names == ("A", "B", "change")
    assert set(imports) == {"one", "two", "third", "four", "fifth"}
    assert set(found.loads) == {("one", ""), ("two.part", ""), ("three", ""), ("pkg", "four"), ("pkg", "five")}
    assert {use.partition(".")[0] for use in change.uses} >= {"one", "two", "third", "four", "fifth", "A", "B"}
    assert set(change.reaches) == {("six", ""), ("seven", ""), ("pkg.deep", "eight"), ("pkg.deep", "nine")}


@pytest.mark.parametrize(("text", "names", "runs"), [(b"a = b = c[0] = 1", ("a", "b"), True),
                                                     (b"a, (b, c) = d = f()", ("a", "b", "c", "d"), True),
                                                     (b"a = b, c = f()", ("a", "b", "c"), False),
                                                     (b"a, b.c = f()", ("a",), True)])  # fmt: skip
def test_every_target_of_an_assignment_is_bound(text: bytes, names: tuple[str, ...], runs: bool) -> None:
    (found,) = read(text).definitions
    assert (found.names, found.runs) == (names, runs)
