"""The mutation checker finds each kind of mistake, and tells tests that notice from tests that do not."""

import ast
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))


def changed(body: str) -> dict[str, set[str]]:
    """The mutated right-hand sides of `return <body>` in a function of some arguments, by kind."""
    from mutation.mutants import mutants

    source = (
        f"def f(height, width, source, target, camera_t, camera_s, view, x, y, q, dark, bright):\n    return {body}\n"
    )
    out: dict[str, set[str]] = {}
    for mutant in mutants(source):
        text = ast.unparse(ast.parse(mutant.apply(source)).body[0].body[0])  # type: ignore[attr-defined]
        text = text.removeprefix("return ").replace("lambda :", "lambda:")  # as Python 3.10 writes it
        out.setdefault(mutant.kind, set()).add(text)
    return out


@pytest.mark.parametrize(
    ("body", "kind", "mutants"),
    [
        ("q - 3", "sign", {"q + 3"}),
        ("-q", "sign", {"q"}),
        ("q + 3", "dropped term", {"q", "3"}),
        ("q * view", "factor", {"q", "view", "q / view"}),
        ("q / view", "factor", {"q", "q * view"}),
        ("q * 2", "constant", {"q * 1"}),
        ("q * 3", "constant", {"q * 6"}),
        ("q + 0.5", "half a pixel", {"q"}),
        ("q ** 2", "power", {"q"}),
        ("torch.sqrt(q)", "power", {"q"}),
        ("q.square()", "power", {"q"}),
        ("q > 3", "comparison", {"q < 3"}),
        ("q > 3 and view", "condition", {"q > 3", "view"}),
        ("~q", "condition", {"q"}),
        ("q.sum(dim=0)", "axes", {"q.sum(dim=1)"}),
        ("q.sum(1)", "axes", {"q.sum(0)"}),
        ("q.T", "axes", {"q"}),
        ("q[..., 0]", "axes", {"q[..., 1]"}),
        ("q[:, None]", "axes", {"q[None]"}),
        ("q @ view", "axes", {"view @ q"}),
        ("(height, q)", "axes", {"(width, q)"}),
        ("f(height, width)", "axes", {"f(width, height)", "f(width, width)", "f(height, height)"}),
        ("f(camera_t)", "wrong view", {"f(camera_s)"}),
        ("q[view]", "wrong view", {"q[0]"}),
        ("q(view)", "wrong view", {"q(0)"}),
        ("F.leaky_relu(q)", "activation", {"F.relu(q)"}),
        ("F.max_pool2d(q, 3)", "activation", {"F.avg_pool2d(q, 3)"}),
        ("q.mean()", "reduction", {"q.sum()"}),
        ("max(q, 3)", "extremes", {"min(q, 3)"}),
        ("range(q)", "range", {"range(q - 1)"}),
        ("np.linspace(q, 9, 5)", "range", {"np.linspace(q, 9, 5 + 1)"}),
        ("q[1:]", "range", {"q[0:]"}),
        ("q.detach()", "gradient", {"q"}),
        ("pad(q, mode='reflect')", "mode", {"pad(q, mode='replicate')"}),
        ("pad(q, centred=True)", "option", {"pad(q, centred=False)"}),
        ("digest(q, view)", "identity", {"digest(q)", "digest(view)"}),
        ("digest({'a': q, 'b': view})", "identity", {"digest({'a': q})", "digest({'b': view})"}),
        ("key_of([q, view], x)", "identity", {"key_of([q], x)", "key_of([view], x)", "key_of([q, view])", "key_of(x)"}),
        ("draw(seed=q.seed)", "seed", {"draw(seed=0)"}),
        ("draw(q.seed)", "seed", {"draw(0)"}),
        ("[q for q in views]", "only the first", {"[q for q in list(views)[:1]]"}),
        ("q @ q.matrix.T", "colour matrix", {"q", "q @ q.matrix"}),
        ("dark + bright", "wrong end", {"bright + bright", "dark + dark"}),
        ("max(light, 3)", "wrong end", {"min(light, 3)"}),
        ("signal_e[0]", "wrong end", {"signal_e[-1]"}),
        ("quantile(q, 0.1)", "wrong end", {"quantile(q, 1 - 0.1)"}),
        ("q * view.gain", "gain", {"q / view.gain"}),
        ("default_rng([q.seed, view, 7])", "seed", {"default_rng([view, 7])", "default_rng([q.seed, 7])"}),
        ("replace(q.views, viewmats=x)", "cameras", {"q.views"}),
        ("q.views + view.views", "cameras", {"q.views + q.views", "view.views + view.views"}),
        (
            "sha256(q + f'{x}:{y}'.encode())",
            "identity",
            {
                "sha256(q)",
                "sha256(f'{x}:{y}'.encode())",
                "sha256(q + f':{y}'.encode())",
                "sha256(q + f'{x}:'.encode())",
            },
        ),
        ("memo.once((q, view), x)", "identity", {"memo.once((q,), x)", "memo.once((view,), x)"}),
        (
            "stage(inputs=lambda: {'a': q, 'b': x})",
            "identity",
            {"stage(inputs=lambda: {'a': q})", "stage(inputs=lambda: {'b': x})"},
        ),
    ],
)
def test_a_rule_yields_the_mistakes_of_its_kind(body, kind, mutants, monkeypatch):
    from mutation import rules

    monkeypatch.setattr(rules, "relatives", lambda *_: ())
    assert changed(body)[kind] == mutants


@pytest.mark.parametrize("body", ["f'{q}: {view} px'", "q.norm(keepdim=True)", "q.clamp_min", "'a' + 'b'"])
def test_messages_and_harmless_options_are_left_alone(body):
    assert changed(body) == {}


def test_all_parts_of_what_a_function_named_identity_returns_are_dropped_in_turn(monkeypatch):
    from mutation import rules
    from mutation.mutants import mutants

    monkeypatch.setattr(rules, "relatives", lambda *_: ())

    def dropped(name: str) -> set[str]:
        source = f"def {name}(q, x):\n    return json.dumps([q, x]).encode() + b'7'\n"
        found = [m.apply(source).split("return ")[1].strip() for m in mutants(source) if m.kind == "identity"]
        return {ast.unparse(ast.parse(text)) for text in found}

    assert dropped("f") == set()
    assert dropped("_identity") == dropped("view_key") == {
        "json.dumps([x]).encode() + b'7'", "json.dumps([q]).encode() + b'7'", "json.dumps([q, x]).encode()", "b'7'",
    }  # fmt: skip


def test_floors_validation_annotations_and_docstrings_are_left_alone():
    from mutation.mutants import mutants

    source = '''
class Config:
    """Holds 1 + 1."""

    def __post_init__(self):
        if self.a < 0:
            raise ValueError("a")

def f(x: Literal[1, 2]) -> "max":
    """min"""
    if x < 0:
        raise ValueError(x + 1)
    assert x > 0
    return x.clamp_min
'''
    assert mutants(source) == []
    assert {m.kind for m in mutants("y = q / x.clamp_min(1e-9)\n")} == {"factor", "extremes", "dropped term"}


def test_a_mutant_says_where_it_is_and_moves_no_line():
    from mutation.mutants import mutants

    source = "A = 3\n\n\nclass C:\n    def f(self, a):\n        a += g(\n            a,\n        )\n        return a\n"
    found = mutants(source)
    assert {(m.function, m.line, m.lines, m.imported) for m in found if m.kind in ("constant", "dropped step")} == {
        ("", 1, (1, 1), True),
        ("C.f", 6, (6, 8), False),
    }
    for mutant in found:
        text = mutant.apply(source)
        ast.parse(text)
        assert text.count("\n") == source.count("\n")
        assert text.splitlines()[-1].startswith("        return ")


MODULE = "def area(height, width):\n    return height * width\n\n\ndef half(q):\n    return q / 2\n"
WEAK = "from {name} import area, half\n\n\ndef test_area():\n    assert area(1, 1) == 1\n"
GOOD = WEAK + "    assert area(2, 3) == 6\n\n\ndef test_half():\n    assert half(3) == 1.5\n"


@pytest.mark.parametrize(("tests", "caught"), [(WEAK, 0.0), (GOOD, 1.0)], ids=["weak", "good"])
def test_weak_tests_let_mutants_survive_and_good_ones_catch_them(tmp_path, monkeypatch, tests, caught):
    from mutation import baseline, judge
    from mutation.mutants import mutants

    name = "weakly_tested" if tests == WEAK else "well_tested"
    (tmp_path / f"{name}.py").write_text(MODULE)
    (tmp_path / "test_it.py").write_text(tests.format(name=name))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    known = judge.baseline(tmp_path, [f"{name}.py"], "test_it.py", tmp_path / "known.json")
    wanted = [m for m in mutants(MODULE) if m.kind == "factor"][:4]
    jobs = [
        judge.Job(
            file=f"{name}.py", mutant=m, key=str(i), limit=60.0,
            tests=tuple(baseline.tests_reaching(known, f"{name}.py", m, everywhere=False)),
        )
        for i, m in enumerate(wanted)
    ]  # fmt: skip
    verdicts = [entry["verdict"] for entry in judge.verdicts(tmp_path, jobs, 2)]
    assert len(verdicts) == len(wanted) == 4
    assert verdicts.count("caught") / len(verdicts) == caught
    assert name not in sys.modules
    assert (tmp_path / f"{name}.py").read_text() == MODULE


def test_a_mutant_that_never_ends_is_caught_by_the_clock(tmp_path, monkeypatch):
    from mutation import judge
    from mutation.mutants import mutants

    source = "def count(stop):\n    n = 0\n    while n < stop:\n        n += 1\n    return n\n"
    (tmp_path / "counting.py").write_text(source)
    (tmp_path / "test_it.py").write_text("from counting import count\n\n\ndef test_it():\n    assert count(3) == 3\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    endless = next(m for m in mutants(source) if m.kind == "dropped step")
    job = judge.Job(file="counting.py", mutant=endless, key="", tests=("test_it.py::test_it",), limit=2.0)
    (entry,) = judge.verdicts(tmp_path, [job], 1)
    assert (entry["verdict"], entry["by"]) == ("caught", "time limit")


def test_the_choice_is_spread_over_kinds_and_functions_and_grows_without_changing():
    import random

    from mutation.mutants import mutants
    from mutation_check import in_turn, shares

    source = "".join(f"def f{i}(a, q):\n    return q[..., 0] * 3 - a.mean()\n\n\n" for i in range(5))
    candidates = [("a.py", mutant) for mutant in mutants(source)]
    order = in_turn(candidates, random.Random(0))
    assert sorted(order, key=repr) == sorted(candidates, key=repr)
    kinds = {m.kind for _, m in candidates}
    assert {m.kind for _, m in order[: len(kinds)]} == kinds
    signs = [m.function for _, m in order if m.kind == "sign"]
    assert set(signs) == {f"f{i}" for i in range(5)}
    assert in_turn(candidates, random.Random(0)) == order
    assert shares({"a": 100, "b": 400, "c": 0}, 30) == {"a": 10, "b": 20}


def test_survivors_are_listed_with_the_reason_that_excuses_them(monkeypatch, tmp_path):
    import mutation_check

    monkeypatch.setattr(mutation_check, "ROOT", tmp_path)
    (tmp_path / "a.py").write_text("x = 1 + 2\ny = 3 + 4\n")
    common = {"file": "a.py", "kind": "sign", "by": "", "verdict": "survived"}
    entries = [
        common | {"line": 1, "before": "1 + 2", "after": "(1 - 2)"},
        common | {"line": 2, "before": "3 + 4", "after": "(3 - 4)"},
        common | {"line": 2, "before": "3", "after": "(6)", "verdict": "caught"},
    ]
    excuses = [{"file": "a.py", "line": "x = 1", "after": "(1 - 2)", "reason": "nobody reads x"}]
    text = mutation_check.summary(entries, excuses)
    assert "| `a.py` | 3 | 1 | 1 | 1 |" in text
    assert "Caught: 33.3%" in text
    assert "`1 + 2` becomes `(1 - 2)`: nobody reads x" in text
    assert "`3 + 4` becomes `(3 - 4)`: to be caught" in text


def test_a_mutant_keeps_its_name_until_the_code_of_its_file_changes():
    from mutation.mutants import mutants
    from mutation.record import keys

    def named(source: str) -> list[str]:
        return list(keys("a.py", source, mutants(source)).values())

    source = "def f(a, q):\n    return a + q, a + q\n"
    first = named(source)
    assert len(set(first)) == len(first)  # equal expressions are told apart
    assert named('"""Doc."""\n\ndef f(a, q):  # why\n    """More."""\n    return a + q, a + q\n') == first
    assert not set(named(source.replace("a, q)", "a, q, c)"))) & set(first)


def test_a_verdict_holds_while_its_test_or_for_survivors_all_tests_are_the_same(tmp_path):
    from mutation.record import code_of_test, holds

    path = tmp_path / "test_a.py"
    path.write_text("def test_x():\n    assert f(1)\n")
    test = "test_a.py::test_x[3]"
    caught = {"verdict": "caught", "by": test, "by_code": code_of_test(tmp_path, test), "tests": "old"}
    survived = {"verdict": "survived", "by": "", "by_code": "", "tests": "old"}
    path.write_text("def test_y():\n    pass\n\n\ndef test_x():\n    assert f(1)  # the same\n")
    assert holds(caught, tmp_path, "new")
    assert holds(survived, tmp_path, "old")
    assert not holds(survived, tmp_path, "new")
    path.write_text("def test_x():\n    assert f(2)\n")
    assert not holds(caught, tmp_path, "old")
    assert holds({**caught, "by": "time limit", "by_code": ""}, tmp_path, "new")


def test_the_nearest_tests_lie_in_the_mirrored_folder_or_above_it_and_name_import_or_mention_the_module(tmp_path):
    from mutation.nearest import nearest

    texts = {
        "a/b/five.py": "def high(): pass\n\n\ndef _low(): pass\n",
        "tests/a/test_all.py": "import a.deep.two",
        "tests/a/test_one_by_one.py": "",
        "tests/a/b/test_two_hard_cases.py": "_low",
        "tests/a/b/test_twofold.py": "from a.b import (\n    one,\n    three,\n)\nfrom a.b import two",
        "tests/a/b/test_rest.py": "from a.b.two.parts import high",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert nearest(tmp_path, "a/b/two.py") == ("tests/a/b/test_two_hard_cases.py",)
    assert nearest(tmp_path, "a/b/three.py") == ("tests/a/b/test_twofold.py",)
    assert nearest(tmp_path, "a/b/_four.py") == tuple(sorted(name for name in texts if "s/a/b/" in name))
    assert nearest(tmp_path, "a/b/five.py") == ("tests/a/b/test_rest.py",)
    assert nearest(tmp_path, "a/deep/two.py") == ("tests/a/test_all.py",)
    assert nearest(tmp_path, "a/one.py") == ("tests/a/test_one_by_one.py",)


def test_chosen_kinds_are_drawn_in_equal_shares_all_over_the_product_and_judged_by_the_nearest_tests(monkeypatch):
    import argparse

    import mutation_check
    from mutation.nearest import nearest

    only = "job/|plan|params|fit"
    options = argparse.Namespace(kinds=["identity", "gain"], only=only, count=20, seed=3, beside=[])
    found = mutation_check.chosen(options)
    assert [mutant.kind for _, mutant in found].count("identity") == [m.kind for _, m in found].count("gain") == 10
    assert {name.split("/")[0] for name, _ in found} == {"novags", "sensor_model", "simscenes"}
    options.count = 6
    assert mutation_check.chosen(options) == found[:6]
    root = mutation_check.ROOT
    assert (["simscenes/rigs.py"], list(nearest(root, "simscenes/rigs.py"))) in mutation_check.groups(careless=True)


def test_what_an_earlier_list_names_is_not_drawn_again(tmp_path):
    import argparse
    import collections

    import mutation_check
    from mutation.listing import difference, listing

    def read(found):
        return collections.Counter((name, *difference(m.before, m.after)) for name, m in found)

    kinds = ["only the first", "wrong end"]
    options = argparse.Namespace(kinds=kinds, only="testbed/study", count=10**6, seed=3, beside=[])
    every = mutation_check.chosen(options)
    often = read(every)
    every.sort(key=lambda one: -often[next(iter(read([one])))])  # those first that others read like
    assert max(often.values()) > 1
    lists = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for path, part in zip(lists, (every[:1], every[1:20]), strict=True):
        common = {"key": "", "line": 0, "verdict": "survived", "by": ""}
        entries = [common | {"file": name, "kind": m.kind, "before": m.before, "after": m.after} for name, m in part]
        path.write_text(listing(entries, {}))
    options.beside = lists
    left = mutation_check.chosen(options)
    assert set(left) < set(every)
    assert len(left) == len(every) - 20  # of mutants that read alike as many are left as no list names
    assert read(left) == read(every) - read(every[:20])


def test_a_test_that_fails_already_is_not_asked(tmp_path, monkeypatch):
    from mutation import judge

    (tmp_path / "test_it.py").write_text("def test_good():\n    pass\n\n\ndef test_bad():\n    assert 0\n")
    monkeypatch.chdir(tmp_path)
    known = judge.baseline(tmp_path, [], "test_it.py", tmp_path / "known.json")
    assert list(known["seconds"]) == ["test_it.py::test_good"]


def test_the_list_shows_where_before_and_after_differ_and_the_test_that_failed():
    from mutation.listing import difference, listing

    common = {"file": "a/b.py", "line": 3, "before": 'digest({"a": x,\n  "b": y, "c": z})'}
    entries = [
        common | {"key": "1", "kind": "seed", "after": "(1)", "verdict": "survived", "by": "", "before": "seed"},
        common | {"key": "2", "kind": "identity", "verdict": "caught", "by": "tests/a/test_b.py::test_it[7]",
                  "after": "(digest({'a': x, 'c': z}))"},
    ]  # fmt: skip
    text = listing(entries, {"1": "nobody draws"})
    assert text.splitlines() == [
        "kind,place,before,after,verdict",
        """identity,a/b.py:3,"digest({'a': x, 'b': y, 'c': z})","digest({'a': x, 'c': z})",a/test_b.py test_it""",
        "seed,a/b.py:3,seed,1,survived: nobody draws",
    ]
    assert difference("a\n        if b\n    else c", "(b)") == ("a if b else c", "b")
    assert difference("f(x)", "pass") == ("f(x)", "pass")
    long = "f(" + ", ".join(f"argument_{i}" for i in range(20)) + ")"
    before, after = difference(long, long.replace("_9", "_99"))
    assert (before[0], before[-1]) == ("…", "…")
    assert "argument_9," in before
    assert "argument_99," in after
    assert max(len(before), len(after)) < 70
