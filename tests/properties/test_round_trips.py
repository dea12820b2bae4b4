"""What is written is read back as it was: cameras, Gaussians, pictures, raw files, sensors, variants, records."""

import json
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from novags.methods.variant import parse_variant, read_variants
from novags.splats import Gaussians, read_ply, write_ply
from novags.testbed.folders.photographs.raw_files import read_digital_numbers
from novags.testbed.ledger.contents import jsonable, read_json, write_json
from sensor_model import (
    Banding,
    Defects,
    DualGain,
    Exposure,
    Sensor,
    SensorOptics,
    from_linear16,
    read_sensor,
    sensor_from_dict,
    write_dng,
    write_sensor,
)
from sensor_model.isp import to_linear16
from sensor_model.params import CFAS
from simscenes import Rig, load_set, read_exr, write_cameras, write_exr
from simscenes.rigs import (
    intrinsics,
    intrinsics_to_mitsuba,
    mitsuba_to_intrinsics,
    mitsuba_to_opencv,
    opencv_to_mitsuba,
    opencv_to_opengl,
    opengl_to_opencv,
)
from simscenes.sets.pictures.png import read_codes, write_png

seeds = st.integers(0, 2**32 - 1)


@contextmanager
def folder() -> Iterator[Path]:
    """A folder for one example: a fixture would be shared by all of them."""
    with tempfile.TemporaryDirectory() as path:
        yield Path(path)


@st.composite
def poses(draw: st.DrawFn, count: int = 3) -> np.ndarray:
    """Rigid world-to-camera matrices, also turned by exactly 180 degrees and far from the origin."""
    rng = np.random.default_rng(draw(seeds))
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    made[0, :3, :3] = draw(st.sampled_from([np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, -1, 1])]))
    made[:, :3, 3] = rng.normal(0, 1, (count, 3)) * 10.0 ** draw(st.integers(-6, 6))
    return made


@given(poses())
def test_cameras_through_the_axes_of_opengl_and_mitsuba(viewmats: np.ndarray) -> None:
    size = 1 + np.abs(viewmats[:, :3, 3]).max()
    for there, back in ((opencv_to_opengl, opengl_to_opencv), (opencv_to_mitsuba, mitsuba_to_opencv)):
        assert np.abs(back(there(viewmats)) - viewmats).max() <= 8 * np.finfo(float).eps * size


@given(st.integers(1, 5000), st.integers(1, 5000), st.floats(1, 179), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_intrinsics_through_those_of_mitsuba(w: int, h: int, fov: float, x: float, y: float) -> None:
    K = intrinsics(w, h, fov)
    K[:2, 2] += (x * w, y * h)
    np.testing.assert_allclose(mitsuba_to_intrinsics(*intrinsics_to_mitsuba(K, w, h), w, h), K, rtol=1e-12, atol=1e-9)


@given(poses(count=9), st.floats(5, 5000), st.booleans())
def test_cameras_through_transforms_and_through_colmap(viewmats: np.ndarray, focal: float, colmap: bool) -> None:
    Ks = np.tile([[focal, 0, 3.25], [0, focal, 2.5], [0, 0, 1]], (9, 1, 1))
    rig = Rig(viewmats=viewmats, Ks=Ks, width=7, height=5)
    names = [f"{k:04d}" for k in range(9)]
    with folder() as path:
        write_cameras(path, names, rig)
        for name in names:
            write_png(path / "images" / f"{name}.png", np.zeros((5, 7, 3), np.uint8))
        if colmap:
            (path / "transforms.json").unlink()
        found = load_set(path)
    assert found.names == tuple(names)
    np.testing.assert_array_equal(found.rig.Ks, Ks)
    size = 1 + np.abs(viewmats[:, :3, 3]).max()
    assert np.abs(found.rig.viewmats - viewmats).max() <= 32 * np.finfo(float).eps * size


@given(st.integers(1, 20), st.integers(0, 3), seeds, st.integers(-30, 30))
def test_gaussians_through_ply(count: int, degree: int, seed: int, exponent: int) -> None:
    g = torch.Generator().manual_seed(seed)
    numbers = [torch.randn(count, *shape, generator=g) for shape in ((3,), (4,), (3,), (), ((degree + 1) ** 2, 3))]
    means, quats, scales, opacities, sh = numbers
    gaussians = Gaussians(
        means=means * 10.0**exponent, quats=quats, log_scales=40 * scales, logit_opacities=100 * opacities, sh=1e6 * sh
    )
    with folder() as path:
        write_ply(path / "a.ply", gaussians)
        found = read_ply(path / "a.ply")
    for name, tensor in gaussians.tensors().items():
        if name == "quats":
            unit = torch.nn.functional.normalize(tensor.double(), dim=-1)
            torch.testing.assert_close(found.quats.double(), unit, rtol=0, atol=2e-7)
        else:
            assert torch.equal(found.tensors()[name], tensor), name


shapes = st.tuples(st.integers(1, 9), st.integers(1, 9))
planes = shapes.flatmap(
    lambda shape: st.dictionaries(
        st.text("abcXYZ.", min_size=1, max_size=6).filter(lambda name: name.strip(".") == name and ".." not in name),
        st.one_of(hnp.arrays(np.float32, shape), hnp.arrays(np.uint32, shape),
                  hnp.arrays(np.float16, shape, elements=st.floats(-1000, 1000, width=16))),
        min_size=1, max_size=3,
    )
)  # fmt: skip


@given(planes)
def test_channels_through_exr_bit_for_bit(channels: dict[str, np.ndarray]) -> None:
    with folder() as path:
        write_exr(path / "a.exr", channels)
        found, _ = read_exr(path / "a.exr")
    assert set(found) == set(channels)
    for name, plane in channels.items():
        assert found[name].dtype == plane.dtype
        assert found[name].tobytes() == plane.tobytes()  # NaN and -0 too


@given(shapes, seeds, st.sampled_from([np.uint8, np.uint16]))
def test_codes_through_png(shape: tuple[int, int], seed: int, dtype: Any) -> None:
    codes = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, (*shape, 3)).astype(dtype)
    with folder() as path:
        write_png(path / "a.png", codes)
        found = read_codes(path / "a.png")
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, codes)


def test_every_16_bit_code_through_linear_light() -> None:
    codes = np.arange(65536, dtype=np.uint16)
    np.testing.assert_array_equal(to_linear16(from_linear16(codes)), codes)


@given(st.integers(32, 41), st.integers(32, 41), seeds, st.sampled_from([*CFAS, None, "three chips"]))
def test_digital_numbers_through_dng(h: int, w: int, seed: int, kind: str | None) -> None:
    cfa = kind if kind in CFAS else None
    sensor = Sensor(
        gain=1.0, eta=0.5, mu_e_sat=6e4, black_level=64.25, bits=16, cfa=cfa,
        rgb_response=(0.5, 1.0, 0.7),
    )  # fmt: skip
    shape = (h, w, 3) if kind == "three chips" else (h, w)
    dn = np.random.default_rng(seed).integers(0, 65536, shape).astype(np.uint16)
    with folder() as path:
        write_dng(path / "a.dng", dn, sensor, Exposure(time=0.02))
        np.testing.assert_array_equal(read_digital_numbers(path / "a.dng"), dn)


def positive(low: float = 1e-3, high: float = 1e3) -> st.SearchStrategy[float]:
    return st.floats(low, high)


@st.composite
def sensors(draw: st.DrawFn) -> Sensor:
    """Any camera."""
    bits = draw(st.integers(8, 16))
    share = draw(st.floats(0, 0.2))
    optics = st.one_of(
        st.builds(SensorOptics, corner_angle=st.floats(0, 89), crosstalk=st.floats(0, 0.2),
                  sensor_shape=st.none() | st.tuples(st.integers(1, 9000), st.integers(1, 9000))),
        st.builds(SensorOptics, falloff=st.lists(positive(), min_size=2, max_size=4).map(tuple),
                  psf=st.just(((0.0, share, 0.0), (share, 1 - 3 * share, share), (0.0, 0.0, 0.0)))),
    )  # fmt: skip
    return Sensor(
        gain=draw(positive()), eta=draw(st.floats(0.01, 1)), bits=bits, black_level=draw(st.floats(0, 2**bits - 2)),
        mu_e_sat=draw(positive(1, 1e6)), sigma_d=draw(st.floats(0, 100)), dsnu=draw(st.floats(0, 10)),
        tukey_lambda=draw(st.none() | st.floats(-0.45, 1)), sigma_row=draw(st.floats(0, 3)),
        prnu=draw(st.floats(0, 0.2)), dark_current=draw(st.floats(0, 100)),
        dark_temperature=draw(st.floats(-50, 80)), nonlinearity=draw(st.floats(0, 0.49)),
        blooming=draw(st.booleans()), coupling=draw(st.floats(0, 0.2)), cfa=draw(st.sampled_from([*CFAS, None])),
        rgb_response=(draw(positive()), 1.0, draw(positive())), rgb_bias=(draw(st.floats(-9, 9)), 0.0, 1e-300),
        banding=draw(st.none() | st.builds(Banding, amplitude=st.floats(0, 9), period=st.floats(2, 900))),
        defects=draw(st.none() | st.builds(Defects, hot_fraction=st.floats(0, 1), rts_traps=st.integers(1, 64))),
        optics=draw(st.none() | optics),
        dual_gain=draw(st.none() | st.builds(DualGain, threshold=positive(), sigma_d=positive(), ratio=positive(1))),
        serial=draw(st.integers(0, 2**63 - 1)),
    )  # fmt: skip


@given(sensors(), st.text(st.characters(exclude_categories=["C", "Z"]), max_size=20))
def test_cameras_through_toml(sensor: Sensor, comment: str) -> None:
    with folder() as path:
        write_sensor(path / "a.toml", sensor, comment=comment)
        assert read_sensor(path / "a.toml") == sensor


@given(sensors())
def test_cameras_through_the_record_of_a_capture(sensor: Sensor) -> None:
    with folder() as path:
        write_json(path / "capture.json", {"sensor": asdict(sensor)})
        assert sensor_from_dict(read_json(path / "capture.json")["sensor"]) == sensor
    assert {field.name for field in fields(Sensor)} == set(jsonable(sensor))


names = st.from_regex(r"[a-zA-Z0-9][a-z.0_+-]{0,7}", fullmatch=True)
words = st.text("abcdefgh_", min_size=1, max_size=8)
values = st.one_of(
    st.integers(-(10**9), 10**9), st.floats(allow_nan=False), st.booleans(), st.text("abc xyz", max_size=9)
)


@given(st.dictionaries(names, st.tuples(words, st.dictionaries(words, values, max_size=4)), min_size=1, max_size=3))
def test_variants_through_toml(variants: dict[str, tuple[str, dict[str, Any]]]) -> None:
    def literal(value: Any) -> str:
        if isinstance(value, bool):
            return str(value).lower()
        return repr(value) if isinstance(value, int | float) else f'"{value}"'

    assume(not any("method" in settings for _, settings in variants.values()))
    lines = []
    for name, (method, settings) in variants.items():
        lines += [f'[variant."{name}"]', f'method = "{method}"', *(f"{k} = {literal(v)}" for k, v in settings.items())]
    with folder() as path:
        (path / "a.toml").write_text("\n".join(lines))
        found = read_variants(path / "a.toml")
    assert {v.name: (v.method, dict(v.settings)) for v in found} == variants


@given(names, words, st.dictionaries(words, st.text("abc019.", min_size=1, max_size=6), max_size=4))
def test_variants_through_the_command_line(name: str, method: str, settings: dict[str, str]) -> None:
    listed = ",".join(f"{key}={value}" for key, value in settings.items())
    found = parse_variant(f"{name}={method}" + (f":{listed}" if listed else ""))
    assert (found.name, found.method, found.settings) == (name, method, settings)


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.text()
    | st.integers(1 - 2**64, 2**64 - 1)
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), plain, max_size=4))
def test_records_through_json(record: dict[str, Any]) -> None:
    # A lone surrogate is not text: UTF-8 has no form for it.
    assume(all(ord(c) < 0xD800 or ord(c) > 0xDFFF for c in json.dumps(record, ensure_ascii=False)))
    with folder() as path:
        write_json(path / "a.json", record)
        assert read_json(path / "a.json") == record


@given(st.floats())
def test_numbers_that_json_lacks_are_words(value: float) -> None:
    found = jsonable(value)
    assert found == value if math.isfinite(value) else isinstance(found, str)
