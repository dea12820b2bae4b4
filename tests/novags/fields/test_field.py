"""The kernels of the field say what plain torch says: values, and the gradients of every tensor."""

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.fields.evaluate import GRAIN, basis_of, evaluate, gradients
from novags.fields.field import Field, first_field
from novags.fields.layout import LANES, SIDE, FieldLayout
from novags.fields.reference import evaluate_reference

LAYOUT = FieldLayout(coarsest=3, finest=40, log2_rows=10, static=2, viewed=3)  # dense levels, and ones that share rows


def some_field(layout: FieldLayout = LAYOUT, seed: int = 3) -> Field:
    g = torch.Generator().manual_seed(seed)
    field = first_field(layout, seed, np.arange(SIDE**3) % 3 == 0)
    field.table.copy_(torch.randn(field.table.shape, generator=g) * 0.5)
    field.b1.copy_(torch.randn(field.b1.shape, generator=g) * 0.3)
    field.b2.copy_(torch.randn(field.b2.shape, generator=g))
    return field


def some_samples(rays: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    positions = rng.random((rays * samples, 3), np.float32)
    positions[0], positions[1] = 0.0, 1.0  # the corners of the cube are inside
    directions = torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(rays, 3))), dim=1)
    return positions, basis_of(directions)


def reference(field: Field, positions: np.ndarray, basis: np.ndarray) -> tuple[Tensor, dict[str, Tensor]]:
    tensors = {name: t.double().requires_grad_() for name, t in field.tensors().items()}
    # float32 positions on both sides: rounding in another width would change cells
    args = torch.from_numpy(positions), torch.from_numpy(basis).double()
    return evaluate_reference(field.layout, tensors, field.seeded, *args), tensors


@pytest.mark.parametrize("layout", [LAYOUT, FieldLayout(coarsest=2, finest=30, log2_rows=9, static=0, viewed=0)])
def test_values_and_gradients_of_all_tensors_equal_those_of_plain_torch(layout: FieldLayout) -> None:
    rays, samples = 150, 16  # more than one partial sum of the weights' gradients
    assert rays * samples > GRAIN
    field, (positions, basis) = some_field(layout), some_samples(rays, samples)
    raw, encoded = evaluate(field, positions, basis)
    expected, tensors = reference(field, positions, basis)
    np.testing.assert_allclose(raw, expected.detach().numpy(), rtol=2e-5, atol=2e-5)
    v_raw = np.random.default_rng(7).normal(size=raw.shape).astype(np.float32)
    v_raw[::3] = 0  # samples that add nothing are skipped
    found = gradients(field, positions, basis, encoded, v_raw)
    (expected * torch.from_numpy(v_raw)).sum().backward()
    for name, tensor in tensors.items():
        assert tensor.grad is not None
        scale = float(tensor.grad.abs().max())
        np.testing.assert_allclose(found[name], tensor.grad.numpy(), atol=1e-4 * scale, rtol=1e-3, err_msg=name)
        assert scale > 0


def test_values_and_gradients_do_not_depend_on_the_number_of_threads() -> None:
    field, (positions, basis) = some_field(), some_samples(700, 16)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            raw, encoded = evaluate(field, positions, basis)
            found = gradients(field, positions, basis, encoded, np.ones_like(raw))
            results.append([raw.copy(), *(found[name].copy() for name in sorted(found))])
    finally:
        torch.set_num_threads(before)
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)


def test_no_samples_give_no_outputs_and_zero_gradients() -> None:
    field, empty = some_field(), np.zeros((0, 3), np.float32)
    raw, encoded = evaluate(field, empty, np.zeros((0, 4), np.float32))
    assert raw.shape == (0, LAYOUT.outputs)
    found = gradients(field, empty, np.zeros((0, 4), np.float32), encoded, raw)
    assert all(not gradient.any() for gradient in found.values())


def test_seeds_of_other_numbers_give_other_fields_and_the_same_seed_the_same() -> None:
    one, same, other = (first_field(LAYOUT, seed) for seed in (0, 0, 1))
    assert torch.equal(one.table, same.table)
    assert not torch.equal(one.table, other.table)


def test_levels_have_a_row_for_every_corner_until_the_table_is_full() -> None:
    layout = FieldLayout(coarsest=16, finest=512, log2_rows=17)
    assert layout.resolutions[0] == 16
    assert layout.resolutions[-1] == 512
    assert layout.rows[0] == 17**3
    assert layout.rows[-1] == 1 << 17
    assert layout.starts[-1] == layout.rows.sum()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"static": 4, "viewed": 3}, "room for 15 lanes"),
        ({"finest": 8, "coarsest": 16}, "coarsest <= finest"),
        ({"log2_rows": 30}, "log2_rows must lie in 8..22, got 30"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(wrong: dict[str, int], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        FieldLayout(**wrong)


def test_a_field_of_other_sizes_is_refused() -> None:
    tensors = first_field(LAYOUT, 0).tensors()
    with pytest.raises(ValueError, match=r"b2 of a field must be \[16\], got \[15\]"):
        Field(LAYOUT, **{**tensors, "b2": torch.zeros(LANES - 1)}, seeded=torch.zeros(SIDE**3, dtype=torch.uint8))
