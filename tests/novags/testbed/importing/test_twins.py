"""Claims about which picture of a folder belongs to which dark view."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.importing import pairs
from novags.testbed.importing.pairs import pair_doubts
from novags.testbed.importing.twins import Twins, plain_pictures, twins_by_order, twins_of
from novags.testbed.stages.configs.importing import ImportConfig
from sensor_model import PRESETS, Exposure, srgb_to_linear, write_dng
from simscenes.sets.multiview import MultiviewSet, load_set
from simscenes.sets.pictures.png import write_png
from simscenes.sets.pictures.tiff import ORIENTATION, retagged
from simscenes.sets.writers.camera_files import write_cameras
from tests.miniatures import RIG, VIEWS, dark_picture, lit_picture, write16

QUIET = Console(quiet=True)


def pictures(folder: Path, names: list[str]) -> Path:
    for i, name in enumerate(names):
        write_png(folder / f"{name}.png", lit_picture(i))
    return folder


def dark_views(folder: Path, names: list[str]) -> MultiviewSet:
    pictures(folder / "images", names)
    write_cameras(folder, sorted(names, key=lambda name: f"{name}.png"), RIG)
    return load_set(folder)


NUMBERS = [f"{i:04d}" for i in range(VIEWS)]
BLACK, WHITE = 512, 16383


def imported(dark: Path, **config: Any) -> tuple[np.ndarray, str]:
    """The well-lit picture of view 3 in a capture of these photographs, and what was said."""
    told = io.StringIO()
    stages.import_photographs(dark, dark.with_name("cap"), ImportConfig(**config), Console(stream=told))
    capture = open_capture(dark.with_name("cap"))
    return np.round(255 * capture.source(QUIET).lit(3)) if config.get("lit") else capture.srgb8(3), told.getvalue()


def codes_of(i: int, black: int, white: int, share: float = 1.0) -> np.ndarray:
    light = np.asarray(srgb_to_linear(lit_picture(i) / np.float32(255)))
    return np.round(black + share * (white - black) * light).astype(np.uint16)


@pytest.mark.parametrize(("black", "white"), [(0, 65535), (BLACK, WHITE)])
def test_well_lit_codes_of_16_bits_are_of_full_range_or_on_the_levels_of_the_dark_ones_as_they_fit(
    black: int, white: int, tmp_path: Path
) -> None:
    """Expectation: the picture that was encoded, from a converter or from the camera of the dark ones."""
    write_cameras(tmp_path / "dark", NUMBERS, RIG)
    for i, name in enumerate(NUMBERS):
        write16(tmp_path / "dark" / "images" / f"{name}.png", codes_of(i, BLACK, WHITE, 0.02))
        write16(tmp_path / "lit" / f"{name}.png", codes_of(i, black, white))
    found, told = imported(tmp_path / "dark", lit=tmp_path / "lit", black=BLACK, white=WHITE)
    assert np.abs(found - lit_picture(3)).max() <= 1
    assert f"well-lit 16-bit files: code {black} is black, {white} white, linear in between" in told
    assert f"import: 16-bit files: code {BLACK} is black, {WHITE} white" in told


def test_the_curve_of_well_lit_codes_beside_dark_ones_of_8_bits_is_said_and_can_be_given(tmp_path: Path) -> None:
    write_cameras(tmp_path / "dark", NUMBERS, RIG)
    for i, name in enumerate(NUMBERS):
        write_png(tmp_path / "dark" / "images" / f"{name}.png", dark_picture(i))
        write16(tmp_path / "lit" / f"{name}.png", lit_picture(i).astype(np.uint16) * 257)
    found, told = imported(tmp_path / "dark", lit=tmp_path / "lit", curve="srgb")
    assert np.abs(found - lit_picture(3)).max() <= 1
    assert "well-lit 16-bit files: code 0 is black, 65535 white, srgb in between (--black, --white, --curve)" in told


def test_dark_codes_far_above_the_given_white_are_refused(tmp_path: Path) -> None:
    write_cameras(tmp_path / "dark", NUMBERS, RIG)
    for i, name in enumerate(NUMBERS):
        write16(tmp_path / "dark" / "images" / f"{name}.png", codes_of(i, 0, 65535))
    with pytest.raises(ValueError, match=r"0000.png must have codes up to --white 4095, got \d+% above 1.5 times that"):
        imported(tmp_path / "dark", white=4095)


def test_well_lit_pictures_of_uneven_exposure_are_doubted(tmp_path: Path) -> None:
    write_cameras(tmp_path / "dark", NUMBERS, RIG)
    (tmp_path / "lit").mkdir()
    for i, name in enumerate(NUMBERS):
        write_png(tmp_path / "dark" / "images" / f"{name}.png", dark_picture(i))
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x829A] = 1 / 50 if i % 2 else 1 / 800
        Image.fromarray(lit_picture(i)).save(tmp_path / "lit" / f"{name}.jpg", exif=exif)
    assert "lit: photographs were exposed unevenly" in imported(tmp_path / "dark", lit=tmp_path / "lit")[1]


def test_an_order_that_differs_between_letters_and_numbers_pairs_nothing(tmp_path: Path) -> None:
    """Rationale: by letters, 10 comes before 2, and would be the twin of the first view instead of the last."""
    dark = dark_views(tmp_path / "dark", [f"dark_{i:03d}" for i in range(VIEWS)])
    twins = pictures(tmp_path / "lit", [str(i) for i in range(2, VIEWS + 2)])
    with pytest.raises(
        ValueError, match=r"the dark view dark_000: 10 by their letters, 2 by the numbers in them; give"
    ):
        twins_of(dark, twins, "--lit", QUIET)


def test_names_that_both_count_without_zeros_are_paired_by_order(tmp_path: Path) -> None:
    """Expectation: both orders put 10 with 10."""
    dark = dark_views(tmp_path / "dark", [f"dark{i}" for i in range(2, VIEWS + 2)])
    twins = pictures(tmp_path / "lit", [f"lit-{i}" for i in range(2, VIEWS + 2)])
    found = twins_of(dark, twins, "--lit", QUIET)
    assert [file.stem.removeprefix("lit-") for file in found.files] == [n.removeprefix("dark") for n in dark.names]
    assert found.paired == "order"


def test_twins_in_another_order_or_with_another_picture_are_others(tmp_path: Path) -> None:
    folder = pictures(tmp_path, ["a", "b", "c"])
    a, b, c = (folder / f"{name}.png" for name in "abc")
    digests = [Twins(folder, files, "order").digest() for files in ((a, b), (a, b), (b, a), (a, c), (a, b, c))]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 4
    pictures(tmp_path, ["beside"])
    assert Twins(folder, (a, b), "order").digest() == digests[0]


def test_all_views_without_a_twin_are_counted_and_twins_beyond_them_are_said(tmp_path: Path) -> None:
    names = [f"{i:03d}" for i in range(VIEWS)]
    dark = dark_views(tmp_path / "dark", names)
    with pytest.raises(ValueError, match=rf"has no picture of 2 of {VIEWS} views \(004, 007\)"):
        twins_of(dark, pictures(tmp_path / "some", [n for n in names if n not in ("004", "007")]), "--lit", QUIET)
    found = twins_of(dark, pictures(tmp_path / "more", [*names, "a", "b"]), "--lit", QUIET)
    assert [file.stem for file in found.files] == names


def test_twins_that_are_paired_by_order_are_counted_over_all_dark_pictures(tmp_path: Path) -> None:
    names = [f"{i:03d}" for i in range(VIEWS)]
    dark = dark_views(tmp_path / "dark", names)
    some = replace(dark, names=dark.names[2::3], files=dark.files[2::3])
    twins = pictures(tmp_path / "lit", [f"x{i}" for i in range(VIEWS)])
    assert [file.stem for file in twins_by_order(some, twins, QUIET).files] == [f"x{i}" for i in range(2, VIEWS, 3)]
    assert [file.stem for file in twins_by_order(dark, twins, QUIET).files] == [f"x{i}" for i in range(VIEWS)]
    pictures(twins, ["y"])
    with pytest.raises(ValueError, match=rf"has {VIEWS + 1} pictures \(x0.png to y.png\), .* {VIEWS} \(000.png to"):
        twins_by_order(dark, twins, QUIET)


def test_pairs_of_a_data_set_by_order_are_said_and_refused_where_numbers_have_another_order(tmp_path: Path) -> None:
    dark = dark_views(tmp_path / "dark", [f"IMG_{i}" for i in range(2, VIEWS + 2)])
    told = io.StringIO()
    same = twins_by_order(
        dark, pictures(tmp_path / "same", [f"x{i}" for i in range(2, VIEWS + 2)]), Console(stream=told)
    )
    assert [file.stem[1:] for file in same.there] == [name[4:] for name in dark.names]
    assert "paired by order, IMG_10.png with x10.png" in told.getvalue()
    with pytest.raises(
        ValueError, match=r"dark picture IMG_10.png: 0000.png by their letters, 0008.png by the numbers"
    ):
        twins_by_order(dark, pictures(tmp_path / "lit", NUMBERS), QUIET)


@pytest.mark.parametrize("other", [None, 0, 4, VIEWS - 1])
def test_pairs_by_order_are_said_if_any_name_is_another(other: int | None, tmp_path: Path) -> None:
    names = [f"{name}x" if i == other else name for i, name in enumerate(NUMBERS)]
    told = io.StringIO()
    twins_by_order(dark_views(tmp_path / "dark", NUMBERS), pictures(tmp_path / "lit", names), Console(stream=told))
    assert ("paired by order" in told.getvalue()) == (other is not None)


def masked(folder: Path, suffix: str) -> Path:
    """Photographs, and a mask beside each."""
    for i, name in enumerate(NUMBERS):
        write16(folder / f"{name}.tif", lit_picture(i))
        inside = np.zeros_like(lit_picture(i))
        inside[5:15] = 255
        write_png(folder / f"{name}{suffix}.png", inside)
    return folder


@pytest.mark.parametrize("suffix", ["", "_mask", ".tif"])
def test_masks_beside_twins_are_left_out_and_said(suffix: str, tmp_path: Path) -> None:
    told = io.StringIO()
    found = twins_of(
        dark_views(tmp_path / "dark", NUMBERS), masked(tmp_path / "lit", suffix), "--lit", Console(stream=told)
    )
    assert [file.name for file in found.there] == [f"{name}.tif" for name in NUMBERS]
    assert f"{VIEWS} masks beside the pictures of" in told.getvalue()


def test_two_photographs_of_one_name_are_refused(tmp_path: Path) -> None:
    twins = pictures(tmp_path / "lit", NUMBERS)
    (twins / "0003.dng").write_bytes(b"a raw file")
    with pytest.raises(ValueError, match=r"more than one picture of view 0003 \(0003.dng and 0003.png\): leave one"):
        twins_of(dark_views(tmp_path / "dark", NUMBERS), twins, "--lit", QUIET)


def test_pictures_that_are_all_in_a_folder_of_masks_stay(tmp_path: Path) -> None:
    assert len(plain_pictures(pictures(tmp_path / "masks", NUMBERS))) == VIEWS


TURN = {"180": lambda picture: picture[::-1, ::-1].copy(), "mirrored": lambda picture: picture[:, ::-1].copy()}


def marked(file: Path, picture: np.ndarray, mark: int | None) -> None:
    """A picture with a mark of orientation (EXIF)."""
    exif = Image.Exif()
    if mark is not None:
        exif[0x0112] = mark
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(file, exif=exif)


def noisy(i: int, rng: np.random.Generator, share: float = 0.2) -> np.ndarray:
    picture = share * lit_picture(i)
    return (picture + rng.normal(0, 3, picture.shape)).clip(0, 255).astype(np.uint8)


def both(folder: Path, mark: int | None, twin_mark: int | None, turn: Any = None, share: float = 0.2) -> Path:
    """Dark pictures of a telephone with cameras, and twins that a program may have turned."""
    rng = np.random.default_rng(0)
    write_cameras(folder / "dark", NUMBERS, RIG)
    for i, name in enumerate(NUMBERS):
        marked(folder / "dark" / "images" / f"{name}.png", noisy(i, rng, share), mark)
        marked(folder / "lit" / f"{name}.png", turn(lit_picture(i)) if turn else lit_picture(i), twin_mark)
    return folder / "dark"


@pytest.mark.parametrize("twin_mark", [1, None])
def test_twins_that_a_program_turned_by_their_mark_are_refused(twin_mark: int | None, tmp_path: Path) -> None:
    dark = both(tmp_path, 3, twin_mark, TURN["180"])
    message = (
        r"lit/0000.png states the orientation 1, .*images/0000.png .* 3, .* turned by 180 degrees \(correlation 0.9"
    )
    with pytest.raises(ValueError, match=message):
        imported(dark, lit=tmp_path / "lit")


@pytest.mark.parametrize(("mark", "twin_mark"), [(3, 3), (3, 1), (3, None), (6, None), (1, 8)])
def test_marks_are_of_no_effect_where_pixels_lie_alike(mark: int, twin_mark: int | None, tmp_path: Path) -> None:
    """Rationale: a camera that looks down on a tripod marks one picture so and the next otherwise."""
    found, told = imported(both(tmp_path, mark, twin_mark), lit=tmp_path / "lit")
    np.testing.assert_array_equal(found, lit_picture(3))
    assert "orientation" not in told
    assert "do not show" not in told


def test_marks_that_differ_are_said_where_pictures_are_too_dark_to_show_how_pixels_lie(tmp_path: Path) -> None:
    told = imported(both(tmp_path, 3, None, share=0.0), lit=tmp_path / "lit")[1]
    assert f"3 ({VIEWS} of {VIEWS} views differ), and the pictures do not show whether" in told


@pytest.mark.parametrize("way", ["turned by 180 degrees", "mirrored left to right", "as pictures of the next view"])
def test_twins_that_fit_in_another_way_are_doubted(way: str, tmp_path: Path) -> None:
    dark = both(tmp_path, None, None, TURN.get("180" if "180" in way else "mirrored" if "mirrored" in way else ""))
    if "next" in way:
        for i, name in enumerate(NUMBERS):
            write_png(tmp_path / "lit" / f"{name}.png", lit_picture((i + 1) % VIEWS))
    told = imported(dark, lit=tmp_path / "lit")[1]
    said = f"lit: pictures do not show what others of the same views do: they fit far better {way} (correlation 0."
    assert said in told
    assert f" of {VIEWS} pairs, " in told


def test_clean_exposures_that_are_one_view_off_are_doubted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    write_cameras(tmp_path / "dark", NUMBERS, RIG)
    for i, name in enumerate(NUMBERS):
        write_png(tmp_path / "dark" / "images" / f"{name}.png", noisy(i, rng))
        write_png(tmp_path / "long" / f"{name}.png", lit_picture((i + 1) % VIEWS))
    assert "long: pictures do not show what others" in imported(tmp_path / "dark", clean=tmp_path / "long")[1]


@pytest.mark.parametrize("electrons", [0.01, 0.3, 3.0])
@pytest.mark.parametrize("count", [3, 9, 40])
def test_right_pairs_in_hardly_any_light_raise_no_doubt(count: int, electrons: float, monkeypatch) -> None:
    """Ten sets each, with noise of 2 electrons and a glow that all dark pictures share."""
    monkeypatch.setattr(pairs, "orientation_of", lambda file: 1)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        lit = [lit_picture(i + seed).mean(2) for i in range(count)]
        glow = np.linspace(0, 1, lit[0].shape[1])
        dark = [(rng.poisson(electrons * x / 120) + rng.normal(glow, 2, x.shape)).clip(0) for x in lit]
        files = {Path(f"{i}{kind}"): values[i] for kind, values in (("d", dark), ("l", lit)) for i in range(count)}
        assert pair_doubts({i: (Path(f"{i}d"), Path(f"{i}l")) for i in range(count)}, files.__getitem__) == []


@pytest.mark.parametrize("mark", [1, 3])
def test_pictures_that_were_developed_from_raw_files_and_turned_are_doubted_and_by_their_mark_refused(
    mark: int, tmp_path: Path
) -> None:
    write_cameras(tmp_path / "dark", NUMBERS, RIG)
    for i, name in enumerate(NUMBERS):
        raw = tmp_path / "dark" / "raw" / f"{name}.dng"
        raw.parent.mkdir(exist_ok=True)
        light = lit_picture(i).mean(2) + np.random.default_rng(i).normal(0, 5, lit_picture(i).shape[:2])
        write_dng(raw, (BLACK + light).astype(np.uint16), PRESETS["a7s2-iso6400"], Exposure(time=0.02))
        raw.write_bytes(retagged(raw, {ORIENTATION: mark}) or raw.read_bytes())
        write_png(tmp_path / "dark" / "images" / f"{name}.png", noisy(i, np.random.default_rng(i))[::-1, ::-1].copy())
    if mark == 1:
        assert (
            "dark: pictures do not show what others of the same views do: they fit far better turned by 180"
            in (imported(tmp_path / "dark")[1])
        )
        return
    with pytest.raises(
        ValueError, match=r"0000.png states the orientation 1, .*0000.dng of the same view 3, .* by 180"
    ):
        imported(tmp_path / "dark")
