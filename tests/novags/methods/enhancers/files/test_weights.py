"""Weights of networks on disk: every layout by name, several files, and nothing that runs code."""

import argparse
import pickle
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from novags.methods.enhancers.files.weights import digest_of, read_weights
from novags.methods.enhancers.networks.zero_dce import ZeroDce


def test_weights_are_read_from_every_layout_by_name(tmp_path):
    state = ZeroDce().state_dict()
    save_file(state, tmp_path / "a.safetensors")
    torch.save(state, tmp_path / "b.pth")
    torch.save({"epoch": 3, "state_dict": state, "opts": argparse.Namespace(a=1)}, tmp_path / "c.pth")
    torch.save({"params": {f"module.{n}": v for n, v in state.items()}}, tmp_path / "d.pth")
    for file in sorted(tmp_path.iterdir()):
        found = read_weights((file,))
        assert found.keys() == state.keys(), file
        assert all(torch.equal(found[name], state[name]) for name in state)
    nested = {"state_dict": {"model_R": {"x": torch.ones(2)}, "model_L": {"x": torch.zeros(3)}}}
    torch.save(nested, tmp_path / "e.pth")
    assert {n: len(v) for n, v in read_weights((tmp_path / "e.pth",)).items()} == {"model_R.x": 2, "model_L.x": 3}


def test_a_network_in_two_files_is_read_from_both_and_known_by_both(tmp_path):
    files = tmp_path / "a.safetensors", tmp_path / "b.safetensors"
    save_file({"a": torch.ones(2)}, files[0])
    save_file({"b": torch.zeros(3)}, files[1])
    assert {name: value.tolist() for name, value in read_weights(files).items()} == {"a": [1, 1], "b": [0, 0, 0]}
    before = digest_of(files)
    assert before == digest_of(files)
    save_file({"b": torch.ones(3)}, files[1])
    after = digest_of(files)
    assert len({before, after, digest_of(files[:1]), digest_of(files[::-1])}) == 4
    save_file({"a": torch.zeros(2)}, files[0])
    assert digest_of(files) not in (before, after)


class Runs:
    """What a hostile file does when it is unpickled freely."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "run")


def test_a_file_that_would_run_code_is_refused_and_does_not_run(tmp_path):
    told = tmp_path / "told"
    torch.save({"a": Runs(told)}, tmp_path / "hostile.pth")
    (tmp_path / "bare.pth").write_bytes(pickle.dumps(Runs(told)))
    for name in ("hostile.pth", "bare.pth"):
        with pytest.raises(ValueError, match=name):
            read_weights((tmp_path / name,))
    assert not told.exists()
