"""PLY in and out."""

import numpy as np
import pytest
import torch

from novags.splats import Gaussians, read_ply, write_ply


def cloud(n: int, degree: int) -> Gaussians:
    g = torch.Generator().manual_seed(n)
    return Gaussians(
        means=torch.randn(n, 3, generator=g),
        quats=torch.nn.functional.normalize(torch.randn(n, 4, generator=g), dim=1),
        log_scales=torch.randn(n, 3, generator=g), logit_opacities=torch.randn(n, generator=g),
        sh=torch.randn(n, (degree + 1) ** 2, 3, generator=g),
    )  # fmt: skip


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("n", [0, 1, 57])
def test_round_trip_is_exact(tmp_path, degree, n):
    gaussians = cloud(n, degree)
    write_ply(tmp_path / "a.ply", gaussians)
    again = read_ply(tmp_path / "a.ply")
    for name, tensor in gaussians.tensors().items():
        torch.testing.assert_close(again.tensors()[name], tensor, rtol=0, atol=1e-6 if name == "quats" else 0)


@pytest.mark.parametrize("length", [1e-42, 1e-25, 1e-20, 1e19, 1e25, 3e38])
def test_rotations_of_any_length_are_written_with_length_1(tmp_path, length):
    gaussians = cloud(20, 0)
    turns = gaussians.quats.clone()
    gaussians.quats = (turns.double() * length).float()
    write_ply(tmp_path / "a.ply", gaussians)
    # 1e-42 is a subnormal number of 10 bits
    torch.testing.assert_close(read_ply(tmp_path / "a.ply").quats, turns, rtol=0, atol=1e-3 if length < 1e-38 else 1e-6)


def test_a_rotation_of_zero_is_not_written(tmp_path):
    gaussians = cloud(3, 0)
    gaussians.quats[1] = 0
    with pytest.raises(ValueError, match=r"quats must not be zero, got \[0.0, 0.0, 0.0, 0.0\] at Gaussian 1"):
        write_ply(tmp_path / "a.ply", gaussians)


def test_layout_is_that_of_3dgs(tmp_path):
    gaussians = cloud(3, 3)
    write_ply(tmp_path / "a.ply", gaussians)
    header, data = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 3"]
    names = [line.split()[2] for line in lines[3:]]
    rest = [f"f_rest_{i}" for i in range(45)]
    assert names == [
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest,
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]  # fmt: skip
    table = np.frombuffer(data, "<f4").reshape(3, len(names))
    row = dict(zip(names, table[1], strict=True))
    assert row["x"] == gaussians.means[1, 0]
    assert row["rot_0"] == pytest.approx(float(gaussians.quats[1, 0]), abs=1e-7)
    # channel-major: the 15 red coefficients first
    assert row["f_rest_0"] == gaussians.sh[1, 1, 0]
    assert row["f_rest_14"] == gaussians.sh[1, 15, 0]
    assert row["f_rest_15"] == gaussians.sh[1, 1, 1]
    assert row["opacity"] == gaussians.logit_opacities[1]


def test_other_orders_types_and_extra_properties_are_read(tmp_path):
    gaussians = cloud(4, 0)
    names = ["rot_0", "rot_1", "rot_2", "rot_3", "label", "opacity", "f_dc_2", "f_dc_1", "f_dc_0", "z", "y", "x"]
    names += ["scale_0", "scale_1", "scale_2"]
    record = np.dtype([(name, "u1" if name == "label" else "<f8") for name in names])
    table = np.zeros(4, record)
    for i in range(4):
        table[f"rot_{i}"] = gaussians.quats[:, i].numpy()
    for i in range(3):
        table[f"f_dc_{i}"], table[f"scale_{i}"] = gaussians.sh[:, 0, i].numpy(), gaussians.log_scales[:, i].numpy()
        table["xyz"[i]] = gaussians.means[:, i].numpy()
    table["opacity"] = gaussians.logit_opacities.numpy()
    kinds = [f"property {'uchar' if name == 'label' else 'double'} {name}" for name in names]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment made elsewhere",
        "element vertex 4",
        *kinds,
        "end_header",
    ]
    (tmp_path / "b.ply").write_bytes(("\n".join(header) + "\n").encode() + table.tobytes())
    again = read_ply(tmp_path / "b.ply")
    for name, tensor in gaussians.tensors().items():
        assert torch.equal(again.tensors()[name], tensor), name


def test_opacities_of_zero_and_one_are_taken_from_files_of_converters(tmp_path):
    """Niantic's spz_to_ply writes the logits of the bytes 0 and 255, which are infinite."""
    gaussians = cloud(4, 1)
    gaussians.logit_opacities[:] = torch.tensor([-torch.inf, torch.inf, 40.0, 0.5])
    write_ply(tmp_path / "a.ply", gaussians)
    again = read_ply(tmp_path / "a.ply")
    assert again.opacities.tolist() == pytest.approx([0, 1, 1, torch.tensor(0.5).sigmoid().item()], abs=2e-7)
    assert again.logit_opacities[2:].tolist() == [40.0, 0.5]  # finite ones stay as they are
    assert again.logit_opacities.isfinite().all()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda raw: b"obj" + raw[3:], "must start with the line 'ply'"),
        (lambda raw: raw[:-5], "must hold 3 vertices"),
        (lambda raw: raw[:40], "its header ends early"),
        (lambda raw: raw.replace(b"binary_little_endian", b"ascii"), "must be binary_little_endian, got ascii"),
        (lambda raw: raw.replace(b"float opacity", b"float opaqueness"), "lacks the vertex properties opacity"),
        (lambda raw: raw.replace(b"float f_rest_3", b"float other_3"), "0, 9, 24 or 45 f_rest properties, got 8"),
        (lambda raw: raw.replace(b"property float x", b"property list uchar int x"), "must be plain numbers"),
        (lambda raw: raw.replace(b"property float y", b"property float x"), "plain numbers, each once"),
        (lambda raw: raw.replace(b"property float x", b"property"), "a line of the PLY header is not complete"),
        (lambda raw: raw.replace(b"element vertex 3", b"element vertex"), "a line of the PLY header is not complete"),
        (lambda raw: raw.replace(b"vertex 3", b"vertex " + b"9" * 400), "number of vertices must be a whole number"),
        (lambda raw: raw.replace(b"vertex 3", b"vertex 999999999999999"), "must hold 999999999999999 vertices"),
        (lambda raw: raw.replace(b"vertex 3", b"vertex -3"), "number of vertices must be a whole number"),
        (lambda raw: raw.replace(b"end_header\n", b"comment\n" * 2000), "its header ends early"),
        (lambda raw: raw[:-4] + b"\0\0\xc0\x7f", "must hold finite numbers in rot_0, rot_1, rot_2, rot_3, got .* at 2"),
        (lambda raw: raw[:-32] + b"\0\0\xc0\x7f" + raw[-28:], "must hold finite numbers in opacity, got .* at 2"),
        (lambda raw: raw[:-4] + b"\0\0\x80\x7f", "must hold finite numbers in rot_0, rot_1, rot_2, rot_3, got .* at 2"),
        (
            lambda raw: raw[:-150] + bytes(150),
            r"of non-zero length, got \[0, 0, 0, 0\] at 1 \(2 of 3\): write it again",
        ),
        (lambda raw: raw.replace(b"vertex 3", b"vertex 2"), "must end after 2 vertices of 104 bytes, .* 312 bytes"),
    ],
)
def test_damaged_files_are_refused(tmp_path, damage, message):
    write_ply(tmp_path / "a.ply", cloud(3, 1))
    (tmp_path / "a.ply").write_bytes(damage((tmp_path / "a.ply").read_bytes()))
    with pytest.raises(ValueError, match=message):
        read_ply(tmp_path / "a.ply")


def test_what_other_elements_hold_after_the_vertices_is_ignored(tmp_path):
    write_ply(tmp_path / "a.ply", cloud(3, 0))
    header, data = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    more = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "b.ply").write_bytes(header + more + data + b"\x01\0\0\0\0")
    assert torch.equal(read_ply(tmp_path / "b.ply").means, cloud(3, 0).means)


def test_writing_leaves_no_temporary_file(tmp_path):
    write_ply(tmp_path / "a.ply", cloud(3, 1))
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]
