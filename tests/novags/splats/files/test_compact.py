""".splat and .spz through decoders written here from the formats' descriptions; errors within the quantisation."""

import gzip
import math
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch

from novags.splats import Gaussians, rasterize, read_ply, write_ply
from novags.splats.files.compact import write_splat, write_spz


def cloud(n: int, degree: int) -> Gaussians:
    g = torch.Generator().manual_seed(n)
    return Gaussians(
        means=3 * torch.randn(n, 3, generator=g), quats=torch.randn(n, 4, generator=g),
        log_scales=torch.randn(n, 3, generator=g) - 3, logit_opacities=2 * torch.randn(n, generator=g),
        sh=0.4 * torch.randn(n, (degree + 1) ** 2, 3, generator=g),
    )  # fmt: skip


def turned_alike(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle in radians between rotations given as quaternions [N, 4]."""
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
    return float(2 * np.arccos(np.minimum(np.abs((a * b).sum(1)), 1)).max())


def decode_splat(data: bytes) -> dict[str, np.ndarray]:
    """antimatter15's records, byte by byte as its shader reads them."""
    rows = [data[i : i + 32] for i in range(0, len(data), 32)]
    return {
        "means": np.array([struct.unpack("<3f", row[:12]) for row in rows]),
        "scales": np.array([struct.unpack("<3f", row[12:24]) for row in rows]),
        "rgba": np.array([list(row[24:28]) for row in rows]) / 255,
        "quats": (np.array([list(row[28:32]) for row in rows]) - 128) / 128,
    }


def test_splat_records_hold_the_gaussians_weightiest_first(tmp_path):
    g = cloud(300, 3)
    write_splat(tmp_path / "a.splat", g)
    data = (tmp_path / "a.splat").read_bytes()
    assert len(data) == 300 * 32
    found = decode_splat(data)
    weight = g.scales.prod(1) * g.opacities
    order = torch.argsort(weight, descending=True).numpy()
    assert np.array_equal(found["means"], g.means.numpy()[order])
    np.testing.assert_allclose(found["scales"], g.scales.numpy()[order], rtol=1e-6)
    colors = np.clip(0.5 + 0.5 / np.sqrt(np.pi) * g.sh[:, 0].numpy(), 0, 1)
    rgba = np.concatenate([colors, g.opacities.numpy()[:, None]], 1)
    assert np.abs(found["rgba"] - rgba[order]).max() <= 0.5 / 255 + 1e-6
    assert turned_alike(found["quats"], g.quats.numpy()[order]) < 0.02  # four components within 1/256, or 1/128 at +1


def decode_spz(data: bytes) -> tuple[dict[str, np.ndarray], int, int]:
    """Niantic's layout, Gaussian by Gaussian: columns as they are, fractional bits and flags."""
    raw = gzip.decompress(data)
    magic, version, n, degree, bits, flags, reserved = struct.unpack("<IIIBBBB", raw[:16])
    assert (raw[:4], version in (2, 3), reserved) == (b"NGSP", True, 0)
    at, coefficients, out = 16, (degree + 1) ** 2 - 1, {}

    def take(count: int) -> bytes:
        nonlocal at
        at += count
        return raw[at - count : at]

    places = [int.from_bytes(take(3), "little", signed=True) / 2**bits for _ in range(3 * n)]
    out["means"] = np.array(places).reshape(n, 3)
    out["opacities"] = np.array(list(take(n))) / 255
    out["base"] = ((np.array(list(take(3 * n))) / 255 - 0.5) / 0.15).reshape(n, 3)
    out["log_scales"] = (np.array(list(take(3 * n))) / 16 - 10).reshape(n, 3)
    quats = []
    for _ in range(n):
        if version == 2:
            xyz = np.array(list(take(3))) / 127.5 - 1
            quats.append([*xyz, np.sqrt(max(0.0, 1 - xyz @ xyz))])
            continue
        word, q = int.from_bytes(take(4), "little"), [0.0] * 4
        largest = word >> 30
        for place in (3, 2, 1, 0):
            if place != largest:
                q[place] = (word & 511) / 511 * np.sqrt(0.5) * (-1 if word >> 9 & 1 else 1)
                word >>= 10
        q[largest] = np.sqrt(1 - sum(v * v for v in q))
        quats.append(q)
    out["quats"] = np.array(quats).reshape(n, 4)[:, [3, 0, 1, 2]]
    out["rest"] = (np.array(list(take(3 * coefficients * n))).reshape(n, coefficients, 3) - 128) / 128
    assert at == len(raw)
    return out, bits, flags


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_spz_holds_the_gaussians_within_its_quantisation(tmp_path, version, degree):
    g = cloud(120, degree)
    write_spz(tmp_path / "a.spz", g, version=version, antialiased=version == 3)
    found, bits, flags = decode_spz((tmp_path / "a.spz").read_bytes())
    assert flags == (1 if version == 3 else 0)
    assert np.abs(found["means"] - g.means.numpy()).max() <= 0.5 / 2**bits + 1e-6
    assert bits >= 12  # not coarser than Niantic's own
    assert np.abs(found["opacities"] - g.opacities.numpy()).max() <= 0.5 / 255 + 1e-6
    base = np.clip(g.sh[:, 0].numpy(), -0.5 / 0.15, 0.5 / 0.15)
    assert np.abs(found["base"] - base).max() <= 0.5 / 255 / 0.15 + 1e-5
    assert np.abs(found["log_scales"] - g.log_scales.numpy()).max() <= 1 / 32 + 1e-5
    assert turned_alike(found["quats"], g.quats.numpy()) < (
        0.25 if version == 2 else 0.005
    )  # w of the first is a small root
    largest = np.where(np.arange(found["rest"].shape[1]) < 3, 4.5, 8.5)[:, None] / 128
    rest = np.clip(g.sh[:, 1:].numpy(), -1, 0.9)
    within = np.abs(found["rest"] - rest) <= largest + 1e-5
    assert (within | (np.abs(rest) > 0.85)).all()


def test_an_spz_scene_looks_as_the_ply_does_to_readers_that_take_its_axes_as_they_are(tmp_path):
    """Rotations and harmonics by what they are for: a picture."""
    g = cloud(40, 3)
    g = replace(g, log_scales=g.log_scales + 1.5)  # large enough to be seen
    write_spz(tmp_path / "a.spz", g)
    write_ply(tmp_path / "a.ply", g)
    found, _, _ = decode_spz((tmp_path / "a.spz").read_bytes())
    tensors = {name: torch.from_numpy(value).float() for name, value in found.items()}
    view = torch.eye(4)[None]
    view[:, 2, 3] = 9.0
    camera = {"Ks": torch.tensor([[[40.0, 0, 20], [0, 40, 16], [0, 0, 1]]]), "width": 40, "height": 32, "sh_degree": 3}
    ply = read_ply(tmp_path / "a.ply")
    image = rasterize(ply.means, ply.quats, ply.scales, ply.opacities, ply.sh, view, **camera)[0]
    shape = tensors["means"], tensors["quats"], tensors["log_scales"].exp(), tensors["opacities"]
    again = rasterize(*shape, torch.cat([tensors["base"][:, None], tensors["rest"]], 1), view, **camera)[0]
    assert image.std() > 0.15
    assert (again - image).abs().mean() < 0.015
    wrong = torch.cat([tensors["base"][:, None], -tensors["rest"]], 1)
    assert (rasterize(*shape, wrong, view, **camera)[0] - image).abs().mean() > 0.1


@pytest.mark.parametrize("write", [write_splat, write_spz])
@pytest.mark.parametrize("length", [1e-25, 1e-20, 1e19, 1e25])
def test_rotations_of_any_length_give_the_same_file(tmp_path, write, length):
    g = cloud(50, 0)
    g.quats = torch.nn.functional.normalize(g.quats, dim=1)
    write(tmp_path / "unit", g)
    write(tmp_path / "other", replace(g, quats=2.0 ** round(math.log2(length)) * g.quats))
    assert (tmp_path / "other").read_bytes() == (tmp_path / "unit").read_bytes()


def test_harmonics_of_spz_are_multiples_of_the_step_of_their_degree(tmp_path):
    write_spz(tmp_path / "a.spz", cloud(120, 3))
    columns, *_ = decode_spz((tmp_path / "a.spz").read_bytes())
    steps = np.round(128 * columns["rest"] + 128).astype(int)
    for part, step in ((steps[:, :3], 8), (steps[:, 3:], 16)):
        inner = part[part < 255]  # 255 is cut off
        assert not (inner % step).any()
        assert (inner % (2 * step)).any()


def test_positions_take_as_many_bits_as_fit_and_are_refused_beyond(tmp_path):
    g = cloud(5, 0)
    for size, expected in ((1e-3, 20), (100.0, 16), (8e6, 0)):
        g.means[:] = torch.linspace(-size, size, 15).reshape(5, 3)
        write_spz(tmp_path / "a.spz", g)
        found, bits, _ = decode_spz((tmp_path / "a.spz").read_bytes())
        assert bits == expected
        np.testing.assert_allclose(found["means"], g.means.numpy(), atol=0.5001 / 2**bits)
    g.means[2, 1] = 1e7
    with pytest.raises(ValueError, match=r"positions must be below 2\^23 for \.spz, got 1e\+07"):
        write_spz(tmp_path / "a.spz", g)
    with pytest.raises(ValueError, match=r"version of an \.spz file must be one of \(2, 3\), got 4"):
        write_spz(tmp_path / "a.spz", cloud(5, 0), version=4)


def test_no_gaussians_give_files_of_none(tmp_path):
    write_splat(tmp_path / "a.splat", cloud(0, 3))
    assert (tmp_path / "a.splat").read_bytes() == b""
    write_spz(tmp_path / "a.spz", cloud(0, 3))
    assert decode_spz((tmp_path / "a.spz").read_bytes())[0]["means"].shape == (0, 3)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_a_ply_is_padded_to_degree_3_on_request(tmp_path, degree):
    g = cloud(7, degree)
    write_ply(tmp_path / "a.ply", g, sh_degree=3)
    again = read_ply(tmp_path / "a.ply")
    k = (degree + 1) ** 2
    assert again.sh.shape == (7, 16, 3)
    assert torch.equal(again.sh[:, :k], g.sh)
    assert not again.sh[:, k:].any()
    assert b"property float f_rest_44" in (tmp_path / "a.ply").read_bytes()
    if degree:
        with pytest.raises(ValueError, match=f"sh_degree must be at least {degree}, the Gaussians' degree, got 0"):
            write_ply(tmp_path / "a.ply", g, sh_degree=0)
