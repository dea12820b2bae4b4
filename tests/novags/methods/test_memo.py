import numpy as np
import torch

from novags.methods.memo import Memo, bytes_of


def test_a_result_is_made_once():
    memo, made = Memo(), []
    for _ in range(3):
        assert memo.once("a", lambda: made.append(1) or "result") == "result"
    assert memo.once("b", lambda: "other") == "other"
    assert made == [1]


def test_beyond_the_limit_the_result_asked_for_the_longest_ago_is_dropped():
    memo, made = Memo(limit=100), []

    def ask(key: str) -> None:
        memo.once(key, lambda: made.append(key) or np.zeros(40, np.uint8))

    for key in ("a", "b", "a", "c"):  # b is the one that was not asked for the longest
        ask(key)
    assert memo.size == 80
    for key in ("a", "c", "b"):
        ask(key)
    assert made == ["a", "b", "c", "b"]


def test_results_that_fill_the_limit_exactly_stay_and_one_too_large_is_kept_alone():
    memo = Memo(limit=80)
    for key in ("a", "b"):
        memo.once(key, lambda: np.zeros(40, np.uint8))
    assert list(memo.kept) == ["a", "b"]
    memo.once("c", lambda: np.zeros(500, np.uint8))
    assert list(memo.kept) == ["c"]
    assert memo.size == 500


def test_bytes_are_those_of_the_arrays_in_it():
    assert bytes_of((np.zeros(3), [torch.zeros(2, 5), "text"], 7)) == 24 + 40
