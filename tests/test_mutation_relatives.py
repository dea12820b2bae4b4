"""Careless mistakes have other forms at the same places, which tests of the first forms have not seen."""

import pytest

from tests.test_mutation_check import changed, on_path  # noqa: F401


@pytest.mark.parametrize(
    ("body", "kind", "mutants"),
    [
        ("digest(q, view)", "identity", {"digest(view, view)", "digest(q, q)"}),
        ("digest({'a': q, 'b': view})", "identity", {"digest({'a': view, 'b': view})", "digest({'a': q, 'b': q})"}),
        ("sha256(f'{x}:{y}'.encode())", "identity", {"sha256(f'{y}:{y}'.encode())", "sha256(f'{x}:{x}'.encode())"}),
        ("stage(inputs=lambda: [q, x])", "identity", {"stage(inputs=lambda: [x, x])", "stage(inputs=lambda: [q, q])"}),
        ("draw(seed=q.seed)", "seed", {"draw(seed=1)"}),
        ("default_rng([q.seed, view, 7])", "seed",
         {"default_rng([view, view, 7])", "default_rng([q.seed, q.seed, 7])"}),
        ("[q for q in views]", "only the first", {"[q for q in list(views)[-1:]]", "[q for q in list(views)[1:]]"}),
        ("q @ q.matrix.T", "colour matrix", {"q @ q.matrix.T @ q.matrix.T"}),
        ("max(light, 3)", "wrong end", {"light", "3"}),
        ("signal_e[0]", "wrong end", {"signal_e[1]"}),
        ("quantile(q, 0.1)", "wrong end", {"quantile(q, 0.5)"}),
        ("q * view.gain", "gain", {"q", "q * view.gain * view.gain"}),
        ("view.gain * q", "gain", {"q", "view.gain * (view.gain * q)"}),
        ("q / view.gain", "gain", {"q", "q / view.gain / view.gain"}),
    ],
)  # fmt: skip
def test_a_careless_mistake_has_relatives_at_the_same_place(body, kind, mutants):
    from mutation import rules

    alone = changed(body)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rules, "relatives", lambda *_: ())
        without = changed(body)
    assert alone[kind] - without.get(kind, set()) == mutants
    assert without[kind] <= alone[kind]
