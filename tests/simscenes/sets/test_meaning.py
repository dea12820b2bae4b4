"""Pictures of strangers: codes mean what the file says of them, or it is refused by the name of what it says."""

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import PIL.Image
import PIL.ImageCms
import pytest

from sensor_model.isp import srgb_to_linear, to_srgb8
from simscenes.sets.pictures.exr import read_exr
from simscenes.sets.pictures.exr_meaning import refuse_clear, refuse_foreign, refuse_pixels
from simscenes.sets.pictures.image_file import header, image_size, read_frames, read_light, read_rgb, stated_curve
from simscenes.sets.pictures.meaning import other_primaries
from simscenes.sets.pictures.mosaic import is_mosaic
from simscenes.sets.pictures.profile import kind_of, middle_of
from tests.dngs import mosaic_of, write_tagged

RNG = np.random.default_rng(0)
CODES = RNG.integers(0, 2**16, (12, 16, 3), np.uint16)


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(file: Path, codes: np.ndarray, *chunks: bytes) -> Path:
    content = cv2.imencode(".png", codes[..., ::-1] if codes.ndim == 3 else codes)[1].tobytes()
    cut = content.index(b"IDAT") - 4
    file.write_bytes(content[:cut] + b"".join(chunks) + content[cut:])
    return file


GAMMA = {value: chunk(b"gAMA", struct.pack(">I", round(value * 100_000))) for value in (1.0, 0.45455, 1 / 1.8)}
SRGB = chunk(b"sRGB", b"\0")
PQ, VIDEO, NARROW, YCC = (chunk(b"cICP", bytes(v)) for v in ((9, 16, 0, 1), (1, 1, 0, 1), (1, 13, 0, 0), (1, 13, 6, 1)))
P3 = (0.5151, 0.2412, -0.0011), (0.2920, 0.6922, 0.0419), (0.1571, 0.0666, 0.7841)  # columns to XYZ at D50


@pytest.mark.parametrize(("chunks", "encoded"), [((), 0), ((GAMMA[1.0],), 0), ((SRGB,), 1), ((GAMMA[0.45455],), 1),
                                                 ((SRGB, GAMMA[1.0]), 1), ((VIDEO,), 1)])  # fmt: skip
def test_16_bits_are_light_unless_the_file_says_otherwise(
    chunks: tuple[bytes, ...], encoded: bool, tmp_path: Path
) -> None:
    file = png(tmp_path / "a.png", CODES, *chunks)
    wanted = srgb_to_linear(CODES / 65535) if encoded else CODES / 65535
    np.testing.assert_allclose(read_light(file), wanted, atol=1e-6)
    np.testing.assert_array_equal(read_rgb(file), to_srgb8(read_light(file)))


@pytest.mark.parametrize(
    ("chunks", "message"),
    [
        ((GAMMA[1.0],), r"states linear codes \(gAMA 1\) and has 8 bits"),
        ((GAMMA[1 / 1.8],), r"states another curve between codes and light than sRGB \(gAMA 0.55556\)"),
        ((PQ,), r"\(cICP, transfer 16, PQ\)"),
        ((NARROW,), r"codes of video, from 16 to 235 \(cICP, narrow range\)"),
        ((YCC,), r"states brightness and differences of colours \(cICP, matrix 6\)"),
        ((chunk(b"acTL", struct.pack(">II", 3, 0)),), "is an animated PNG of 3 pictures, of which only the first"),
        ((chunk(b"CgBI", bytes(4)),), r"has the chunk 'CgBI' \(Apple's own form"),
        ((chunk(b"sTER", b"\0"),), r"has the chunk 'sTER' \(two pictures side by side\)"),
        ((chunk(b"qABc", b"\0"),), "has the chunk 'qABc', which can change what its codes mean"),
    ],
)
def test_statements_of_a_png_that_change_its_codes_are_refused(
    chunks: tuple[bytes, ...], message: str, tmp_path: Path
) -> None:
    file = png(tmp_path / "a.png", CODES.astype(np.uint8), *chunks)
    for way in (image_size, read_rgb):
        with pytest.raises(ValueError, match=rf"a\.png .*{message}"):
            way(file)


def test_texts_and_private_chunks_of_a_png_change_nothing(tmp_path: Path) -> None:
    codes = CODES.astype(np.uint8)
    more = [
        chunk(b"tEXt", b"a\0b"),
        chunk(b"pHYs", bytes(9)),
        chunk(b"vpAg", bytes(9)),
        chunk(b"sBIT", b"\5\5\5"),
        SRGB,
    ]
    np.testing.assert_array_equal(read_rgb(png(tmp_path / "a.png", codes, *more)), codes)


def test_profiles_say_the_curve_and_the_primaries(tmp_path: Path) -> None:
    """Expectation: light of the middle code, .214 of sRGB; a parametric curve of exponent 1 is linear."""
    srgb = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
    assert middle_of(srgb) == pytest.approx(float(srgb_to_linear(np.array(0.5))), abs=2e-3)
    place = srgb.index(b"para")
    linear = srgb[: place + 8] + struct.pack(">HH7i", 0, 0, 65536, *[0] * 6) + srgb[place + 40 :]
    assert kind_of(middle_of(linear) or 0) == "linear"
    PIL.Image.fromarray(CODES.astype(np.uint8)).save(tmp_path / "a.jpg", icc_profile=srgb)
    assert stated_curve(tmp_path / "a.jpg") == "srgb"
    PIL.Image.fromarray(CODES.astype(np.uint8)).save(tmp_path / "b.jpg", icc_profile=linear)
    with pytest.raises(ValueError, match=r"b\.jpg states linear codes \(a colour profile: the middle code is 0.500"):
        read_rgb(tmp_path / "b.jpg")
    p3 = srgb
    for name, column in zip((b"rXYZ", b"gXYZ", b"bXYZ"), P3, strict=True):
        at = struct.unpack_from(">I", srgb, srgb.index(name) + 4)[0]
        p3 = p3[: at + 8] + struct.pack(">3i", *(round(v * 65536) for v in column)) + p3[at + 20 :]
    for profile, differs in ((srgb, False), (p3, True)):
        PIL.Image.fromarray(CODES.astype(np.uint8)).save(tmp_path / "c.jpg", icc_profile=profile)
        with header(tmp_path / "c.jpg") as image:
            assert other_primaries(tmp_path / "c.jpg", image) == differs


@pytest.mark.parametrize(("number", "differs"), [(1, False), (2, False), (9, True), (12, True)])
def test_a_png_may_state_the_number_of_its_primaries(number: int, differs: bool, tmp_path: Path) -> None:
    """By ITU-T H.273: 1 of sRGB, 2 not stated, 9 of BT.2020, 12 of Display P3."""
    codes = CODES.astype(np.uint8)
    file = png(tmp_path / "a.png", codes, chunk(b"cICP", bytes([number, 13, 0, 1])))
    np.testing.assert_array_equal(read_rgb(file), codes)
    with header(file) as image:
        assert other_primaries(file, image) == differs


@pytest.mark.parametrize("suffix", ["ppm", "pgm", "jp2"])
def test_kinds_of_which_decoders_keep_8_bits_are_refused_with_more(suffix: str, tmp_path: Path) -> None:
    """Rationale: cut to 8 bits, linear codes would be taken for sRGB-encoded ones."""
    codes = np.repeat(np.repeat(CODES, 4, 0), 4, 1)
    codes = codes[..., 1] if suffix == "pgm" else codes
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), codes)
    with pytest.raises(ValueError, match=r"is a picture of codes up to 65535 in (PPM|JPEG2000), .* as PNG or TIFF"):
        read_rgb(tmp_path / f"a.{suffix}")
    low = (codes >> 8).astype(np.uint8)
    cv2.imwrite(str(tmp_path / f"b.{suffix}"), low)
    off = np.abs(read_rgb(tmp_path / f"b.{suffix}").astype(int) - (low[..., ::-1] if low.ndim == 3 else low[..., None]))
    assert off.max() <= (60 if suffix == "jp2" else 0)  # which loses some
    (tmp_path / "c.ppm").write_bytes(b"P6 # by a camera of 12 bits\n2 1\n4095\n" + bytes(12))
    with pytest.raises(ValueError, match="is a picture of codes up to 4095 in PPM"):
        read_rgb(tmp_path / "c.ppm")


def test_pictures_behind_the_first_one_are_refused_unless_they_are_smaller(tmp_path: Path) -> None:
    first, small = (PIL.Image.fromarray(RNG.integers(0, 255, (*size, 3), np.uint8)) for size in ((24, 32), (12, 16)))
    first.save(tmp_path / "a.jpg", "MPO", save_all=True, append_images=[small])
    assert read_rgb(tmp_path / "a.jpg").shape == (24, 32, 3)
    first.save(tmp_path / "b.jpg", "MPO", save_all=True, append_images=[first])
    first.save(tmp_path / "c.webp", save_all=True, append_images=[small.resize(first.size)])
    for name in ("b.jpg", "c.webp"):
        with pytest.raises(ValueError, match=rf"{name} holds 2 pictures, of which only the first is read"):
            read_rgb(tmp_path / name)
    first.save(tmp_path / "e.jpg", "MPO", save_all=True, append_images=[small, first, small])
    whole = (tmp_path / "e.jpg").read_bytes()
    (tmp_path / "e.jpg").write_bytes(whole[: whole.rindex(b"\xff\xd8\xff")])  # without the last one
    with pytest.raises(ValueError, match=r"e\.jpg holds 4 pictures, of which only the first is read"):
        read_rgb(tmp_path / "e.jpg")
    first.save(tmp_path / "f.jpg", "MPO", save_all=True, append_images=[first, small])
    with pytest.raises(ValueError, match=r"f\.jpg holds 3 pictures, of which only the first is read"):
        read_rgb(tmp_path / "f.jpg")
    first.convert("CMYK").save(tmp_path / "d.jpg")
    with pytest.raises(ValueError, match=r"d\.jpg is a picture in CMYK"):
        read_rgb(tmp_path / "d.jpg")


def write_bmp(path: Path, bits: int, compression: int, masks: tuple[int, ...], pixels: bytes) -> Path:
    """A BMP of 4 x 2 pixels, rows from below."""
    body = struct.pack("<IiiHHIIiiII", 40, 4, 2, 1, bits, compression, len(pixels), 0, 0, 0, 0)
    body += struct.pack(f"<{len(masks)}I", *masks)
    path.write_bytes(struct.pack("<2sIHHI", b"BM", 14 + len(body) + len(pixels), 0, 0, 14 + len(body)) + body + pixels)
    return path


def test_a_bmp_is_read_unless_masks_say_where_its_colours_lie(tmp_path: Path) -> None:
    """Decoders pass over the masks: colours change places. They leave white of 5 bits at 248."""
    plain = write_bmp(tmp_path / "a.bmp", 24, 0, (), bytes([1, 2, 3] * 8))
    assert (read_rgb(plain) == [3, 2, 1]).all()
    for bits, compression, masks in (
        (32, 3, (0xFF000000, 0xFF0000, 0xFF00)),
        (16, 3, (0xF800, 0x7E0, 0x1F)),
        (16, 0, ()),
    ):
        file = write_bmp(tmp_path / "b.bmp", bits, compression, masks, bytes(bits))
        with pytest.raises(ValueError, match=f"is a BMP of {bits} bits a pixel with masks of its colours"):
            read_rgb(file)


GRAY: dict[int, tuple[str, list[float]]] = {
    256: ("I", [16]), 257: ("I", [12]), 258: ("H", [16]), 259: ("H", [1]), 262: ("H", [1]), 277: ("H", [1]),
    278: ("I", [12]),
}  # fmt: skip


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({339: ("H", [2])}, r"is a TIFF of numbers with a sign \(SampleFormat 2\)"),
        ({262: ("H", [32803])}, r"is a TIFF of a camera's mosaic \(PhotometricInterpretation 32803\)"),
        ({301: ("H", [0] * 9)}, r"has the TIFF tag 301 \(TransferFunction, a curve"),
        ({50712: ("H", [0, 9])}, r"has the TIFF tag 50712 \(LinearizationTable"),
        ({51009: ("B", [0] * 4)}, r"has the TIFF tag 51009 \(OpcodeList2"),
        ({32997: ("I", [7])}, r"has the TIFF tag 32997 \(ImageDepth, several pictures in one"),
        ({270: ("A", list(b"ImageJ=1.53k\nimages=9\nslices=9\n\0"))}, "is a stack of 9 pictures"),
        ({270: ("A", list(b'{"shape": [4, 12, 16]}\0'))}, "is a stack of 4 pictures"),
    ],
)
def test_statements_of_a_tiff_that_change_its_codes_are_refused(extra: Any, message: str, tmp_path: Path) -> None:
    extra = {tag: ("B", values) if letter == "A" else (letter, values) for tag, (letter, values) in extra.items()}
    file = write_tagged(tmp_path / "a.tif", CODES[..., 0].tobytes(), GRAY | extra)
    if 270 in extra:  # a text, which has a type of its own
        content = file.read_bytes()
        place = content.index(struct.pack("<HH", 270, 1))
        file.write_bytes(content[: place + 2] + struct.pack("<H", 2) + content[place + 4 :])
    with pytest.raises(ValueError, match=message):
        read_rgb(file)


def test_all_pages_are_read_where_frames_are_asked_for(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    pages = RNG.integers(0, 2**16, (20, 12, 16), np.uint16)
    for name, options in (("a.tif", {}), ("b.tif", {"imagej": True})):
        tifffile.imwrite(tmp_path / name, pages, **({"photometric": "minisblack"} | options))
        np.testing.assert_array_equal(read_frames(tmp_path / name), pages)
        with pytest.raises(ValueError, match="is a TIFF of several pages"):
            read_rgb(tmp_path / name)


EXR: dict[str, Any] = {"type": OpenEXR.scanlineimage}


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        (
            {"chromaticities": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)},
            "of other primaries than sRGB",
        ),  # fmt: skip
        ({"acesImageContainerFlag": 1}, "colours of ACES"),
        ({"oiio:ColorSpace": "ACEScg"}, "states oiio:ColorSpace = 'ACEScg'"),
        ({"pixelAspectRatio": 2.0}, r"pixels that are not square \(pixelAspectRatio 2\)"),
        ({"colorInteropID": "srgb_rec709_display"}, "states colorInteropID"),
        ({"dataWindow": (np.array([1, 1], np.int32), np.array([16, 12], np.int32))}, r"holds a part of its picture"),
    ],
)
def test_statements_of_an_exr_that_change_its_light_are_refused(
    attributes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    light = {name: np.ones((12, 16), np.float32) for name in "RGB"}
    OpenEXR.File(EXR | {"oiio:ColorSpace": "lin_rec709", "comments": "a"}, dict(light)).write(str(tmp_path / "a.exr"))
    refuse_foreign(tmp_path / "a.exr")
    OpenEXR.File(EXR | attributes, dict(light)).write(str(tmp_path / "b.exr"))
    with pytest.raises(ValueError, match=rf"b\.exr .*{message}"):
        refuse_foreign(tmp_path / "b.exr")


def test_exr_files_of_several_parts_transparent_ones_and_codes_are_refused(tmp_path: Path) -> None:
    light = {name: np.ones((12, 16), np.float32) for name in "RGB"}
    parts = [OpenEXR.Part(EXR | {"name": name}, dict(light), name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    with pytest.raises(ValueError, match=r"a\.exr is an EXR file of 2 parts \(left, right\)"):
        refuse_foreign(tmp_path / "a.exr")
    OpenEXR.File(EXR, {**light, "A": np.full((12, 16), 0.5, np.float32)}).write(str(tmp_path / "b.exr"))
    with pytest.raises(ValueError, match=r"b\.exr must be opaque, got 192 of 192 pixels"):
        refuse_clear(read_exr(tmp_path / "b.exr")[0], tmp_path / "b.exr")
    OpenEXR.File(EXR, {**light, "G": np.ones((12, 16), np.uint32)}).write(str(tmp_path / "c.exr"))
    with pytest.raises(ValueError, match=r"c\.exr must hold light as half or float numbers, got integers in G"):
        refuse_pixels(read_exr(tmp_path / "c.exr")[0], tmp_path / "c.exr")
    with pytest.raises(ValueError, match=r"d\.exr must hold R, G, B and A at every pixel, got .*\(6, 8\)"):
        refuse_pixels({**light, "A": np.ones((6, 8), np.float32)}, tmp_path / "d.exr")


def textured(h: int = 96, w: int = 128) -> np.ndarray:
    coarse = RNG.uniform(0.05, 0.9, (h // 6, w // 6, 3))
    return np.asarray(cv2.resize(coarse, (w, h), interpolation=cv2.INTER_CUBIC)).clip(0.01, 1)


@pytest.mark.parametrize("electrons", [40, 1000])
def test_a_mosaic_is_seen_in_texture_and_noise(electrons: int, tmp_path: Path) -> None:
    counts = RNG.poisson(mosaic_of(textured(), 0.0, electrons).clip(0)) + RNG.normal(0, 1, (96, 128))
    codes = np.round(500 + 10 * counts).clip(0, 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), codes)
    with pytest.raises(ValueError, match=r"a\.png must be a developed picture, .* probably the mosaic"):
        read_rgb(tmp_path / "a.png")


def test_gray_pictures_are_not_taken_for_mosaics() -> None:
    """Texture, noise, edges of a pixel, single bright rows, pixels twice as large, nothing at all."""
    rows = np.zeros((96, 128))
    rows[::7] = 900
    gray = textured()[..., 1] * 4000
    several = [gray, RNG.poisson(gray / 100), RNG.integers(0, 255, (96, 128)), np.kron(gray, np.ones((2, 2))), rows,
               (gray > 1500) * 3000, np.full((96, 128), 7), np.zeros((8, 8))]  # fmt: skip
    assert not any(is_mosaic(np.asarray(picture)) for picture in several)


@pytest.mark.parametrize(("share", "found"), [(0.005, False), (0.1, True)])
def test_columns_of_one_camera_that_differ_by_half_a_percent_are_no_mosaic(share: float, found: bool) -> None:
    """Light from 1000 to 3000 without noise: the pattern is sure, and is none of colour filters."""
    gray = np.linspace(1000.0, 3000.0, 128)[:, None] * (1 + share * (np.arange(160) % 2))
    assert is_mosaic(gray) is found


def test_one_mosaic_among_several_pictures_is_none_of_all() -> None:
    mosaic, gray = mosaic_of(textured(), 0.0, 4000), textured()[..., 1] * 4000
    assert is_mosaic(mosaic)
    assert not is_mosaic(mosaic, gray, gray)
    assert not is_mosaic(gray, gray, mosaic)
