"""Sentences name their nouns: none in a docstring, comment, message or page has two words that stand for one."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
CODE = ("sensor_model", "simscenes", "novags", "scripts")
PAGES = (
    "README.md", "CHANGELOG.md", "docs/*.md", "novags/commands/answers/*.txt",
    "novags/testbed/report/templates/**/*.html",
)  # fmt: skip

# Each of these makes the reader look for the noun it stands for ("the error of the fit exceeds that of the mean", "what
# is left of it is removed"). One in a sentence can be followed, two cannot: the sentence is to name its nouns.
STAND_INS = (
    r"that of", r"that which",
    r"what", r"whatever",
    r"those (?:of|that|which|who|whose|in|on|to|with|without|from|for|at|by|above|below|behind|beside|it|they|are)",
    r"as (?:it|they) (?:is|are|was|were|stands?|comes?)",
    r"the ones? (?:that|which|of|in|with|whose|from|for|to|above|below|it)",
    r"(?:all|everything|anything|nothing) that (?:is|are|was|were|it|they)",
)  # fmt: skip
STAND_IN = re.compile(rf"\b(?:{'|'.join(STAND_INS)})\b".replace(" ", r"\s+(?:\#\s+)?"), re.I)
MESSAGE = 4  # words: a shorter string is a name, a key or a unit
FIELD = "…"  # stands where an f-string or a template puts a value

SENTENCE_END = re.compile(r"""(?<=[.!?])["')`*]*\s+|\n\s*\n|\n\s*(?=(?:[-*]|\d+\.)\s|\w+:\s)|\||\x00""")
INLINE_TAG = re.compile(r"</?(?:a|abbr|b|code|em|i|kbd|small|span|strong|sub|sup|time|var)\b[^>]*>", re.S)
TEXT_ATTRIBUTE = re.compile(r'\b(?:title|alt|aria-label|placeholder)="([^"]*)"')


class Sentence(NamedTuple):
    """A sentence and the line it begins on."""

    line: int
    text: str

    @property
    def stand_ins(self) -> list[str]:
        return [" ".join(match.split()).lower() for match in STAND_IN.findall(self.text)]


def sentences(text: str, line: int) -> Iterator[Sentence]:
    """The sentences of a text whose first line is `line`; a list item, a table cell and an argument are others."""
    ends = [(match.start(), match.end()) for match in SENTENCE_END.finditer(text)]
    for (_, start), (end, _) in pairwise([(0, 0), *ends, (len(text), len(text))]):
        if piece := text[start:end].strip():
            yield Sentence(line + text.count("\n", 0, start), " ".join(piece.split()))


def of_python(source: str) -> Iterator[Sentence]:
    """The sentences of docstrings, messages and comments."""
    yield from of_strings(ast.parse(source))
    above: tokenize.TokenInfo | None = None
    block, begin = "", 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        own = not token.line[: token.start[1]].strip()
        if own and above is not None and token.start == (above.start[0] + 1, above.start[1]):
            block += "\n" + token.string.lstrip("# ")
        else:
            yield from sentences(block, begin)
            block, begin = token.string.lstrip("# "), token.start[0]
        above = token if own else None
    yield from sentences(block, begin)


def of_strings(tree: ast.Module) -> Iterator[Sentence]:
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            pieces = [part.value if isinstance(part, ast.Constant) else FIELD for part in node.values]
            text = "".join(str(piece) for piece in pieces)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            text = node.value
        else:
            continue
        if len(text.split()) >= MESSAGE:
            yield from sentences(text, node.lineno)


def without(pattern: str, text: str, instead: str = "") -> str:
    """`text` with the same lines, and `instead` where the pattern matches."""
    return re.sub(pattern, lambda match: instead + "\n" * match.group().count("\n"), text, flags=re.M | re.S)


def of_page(text: str) -> Iterator[Sentence]:
    """The sentences of a page in Markdown, without its headings and its code."""
    text = without(r"^ *```.*?^ *```$", text, "\x00")
    text = without(r"(?<=\n\n) {4}(?! *[-*\d]).*?(?=\n\n|\Z)", text, "\x00")
    text = without(r"`[^`\n]+`", text, FIELD)
    text = without(r"<!--.*?-->", without(r"(?<=\])\([^)]*\)", text), "\x00")
    yield from sentences(without(r"^#+ .*?$", text, "\x00"), 1)


def of_text(text: str) -> Iterator[Sentence]:
    """The sentences of a plain text."""
    yield from sentences(text, 1)


def of_template(text: str) -> Iterator[Sentence]:
    """The sentences of a template: between its tags, in attributes that are shown, in strings of its expressions."""
    text = without(r"\{#.*?#\}|<(script|style)\b.*?</\1>", text)
    for shown in TEXT_ATTRIBUTE.finditer(text):
        yield from sentences(without(r"\{\{.*?\}\}", shown.group(1), FIELD), text.count("\n", 0, shown.start()) + 1)
    for expression in re.finditer(r"\{[{%].*?[}%]\}", text, re.S):
        for string in re.finditer(r"""(["'])(.*?)\1""", expression.group(), re.S):
            if len(string.group(2).split()) >= MESSAGE:
                line = text.count("\n", 0, expression.start() + string.start()) + 1
                yield from sentences(string.group(2), line)
    text = without(r"\{%.*?%\}", without(r"\{\{.*?\}\}", text, FIELD))
    yield from sentences(without(r"<[^>]*>", without(INLINE_TAG.pattern, text), "\x00"), 1)


READERS = {".py": of_python, ".md": of_page, ".txt": of_text, ".html": of_template}


def files() -> list[Path]:
    code = [path for folder in CODE for path in (ROOT / folder).rglob("*.py")]
    return sorted([*code, *(path for pattern in PAGES for path in ROOT.glob(pattern))])


def hard_sentences(path: Path) -> list[str]:
    found = READERS[path.suffix](path.read_text(encoding="utf-8"))
    name = path.relative_to(ROOT).as_posix()
    return [f"{name}:{one.line}: {one.text}" for one in found if len(one.stand_ins) > 1]


@pytest.mark.parametrize("folder", [*CODE, "README.md", "CHANGELOG.md", "docs"])
def test_no_sentence_has_two_words_that_stand_for_a_noun(folder: str) -> None:
    found = [
        sentence for path in files() if path.relative_to(ROOT).parts[0] == folder for sentence in hard_sentences(path)
    ]
    assert not found, "name the noun, one idea a sentence:\n" + "\n".join(found)


BAD = "what is left of its error is that of two samples"
GOOD = "the rest of its error is the error of two samples; it says what it does"


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".py", '"""Top.\n\nIt is so: %s.\n"""\n'),
        (".py", "\n\nx = 1  # %s\n"),
        (".py", "\ndef f(x):\n    raise ValueError(f'{x}: %s')\n"),
        (".py", "\n# above.\n# %s\n"),
        (".md", "# Page\n\n%s\n\n```python\nthat of those that\n```\n"),
        (".md", "`what` becomes `that of` what.\n\n%s\n"),
        (".txt", "\n\n- %s\n"),
        (".html", "<p>{{ a }}</p>\n\n<p>%s</p>"),
        (".html", '<p>{{ a }}</p>\n\n<p title="%s"></p>'),
        (".html", '\n\n{{ note("%s") }}'),
    ],
)
def test_a_bad_sentence_is_found_with_its_line_and_a_good_one_is_not(suffix: str, text: str) -> None:
    found = [one for one in READERS[suffix](text % BAD) if len(one.stand_ins) > 1]
    assert [BAD in one.text for one in found] == [True]
    assert [one.line for one in found] == [text[: text.index("%s")].count("\n") + 1]
    assert not [one for one in READERS[suffix](text % GOOD) if len(one.stand_ins) > 1]


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("the parameters in the middle of those of several single images", 1),
        ("How those that have no class for it put it.", 1),
        ("what cannot be believed is removed, as it was", 2),
        ("the ones\nthat stay are those\nof the first", 2),
        ("those two are what the user asked for, and that offers more", 1),
    ],
)
def test_stand_ins_are_counted_across_line_ends(text: str, count: int) -> None:
    assert [len(one.stand_ins) for one in sentences(text, 1)] == [count]


def test_sentences_items_and_cells_are_told_apart() -> None:
    text = "One. Two\nmore!\n\n- a\n- b\n| c | d |\nname: e"
    assert [one.text for one in sentences(text, 1)] == ["One.", "Two more!", "- a", "- b", "c", "d", "name: e"]
    assert [one.line for one in sentences(text, 1)][:4] == [1, 1, 4, 5]
