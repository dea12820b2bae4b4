"""Claims about the pictures of a page: every code of small ones, and where large ones lie."""

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from novags.testbed.report.look.album import Album, files_of
from novags.testbed.report.look.maps import colour_map


def decoded(uri: str) -> np.ndarray:

    codes = cv2.imdecode(np.frombuffer(base64.b64decode(uri.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert codes is not None
    return codes[..., ::-1]


def test_small_pictures_keep_every_code_in_fewer_bytes_than_png(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    light = np.linspace(0.1, 0.9, 160)[None, :, None] * np.linspace(0.5, 1.0, 160)[:, None, None]
    image = (light * (0.6, 0.8, 1.0) + rng.normal(0, 0.02, (160, 160, 1))).astype(np.float32)
    codes = np.round(255 * image.clip(0, 1)).astype(np.uint8)
    album = Album(tmp_path / "page.html")
    picture = album.add(image)
    album.settle()
    assert (decoded(picture.src) == codes).all()
    assert picture.exact
    assert picture.full is None
    assert picture.data is not None
    assert len(picture.data) < 0.85 * len(cv2.imencode(".png", codes[..., ::-1])[1])


def test_a_map_looks_the_same_at_a_third_of_the_bytes(tmp_path: Path) -> None:
    """Nobody reads the codes of a map; its noise took a third of the page."""
    slopes = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, (160, 160)), (0, 0), 6)
    image = colour_map(0.5 + 6 * slopes, "viridis")
    album = Album(tmp_path / "page.html")
    picture = album.add(image, exact=False)
    album.settle()
    plain = cv2.imencode(".png", np.round(255 * image[..., ::-1]).astype(np.uint8))[1]
    assert picture.data is not None
    assert len(picture.data) < 0.35 * len(plain)
    assert np.abs(decoded(picture.src) - 255 * image).mean() < 6
    assert not picture.exact


def test_a_name_with_quotes_hands_its_data_over(tmp_path: Path) -> None:
    album = Album(tmp_path / "page.html", inside=0)
    script = album.add_data('probe-a "b" \\ c', b"data")
    album.settle()
    assert script.file is not None
    call = (tmp_path / script.file).read_text()
    name, text = json.loads(f"[{call[call.index('(') + 1 : call.rindex(')')]}]")
    assert (name, text) == (script.name, base64.b64encode(b"data").decode())
    assert script.text == ""


def test_large_pictures_are_lossy_at_their_own_size(tmp_path: Path) -> None:
    album = Album(tmp_path / "page.html")
    picture = album.add(np.random.default_rng(0).random((300, 700, 3)).astype(np.float32))
    album.settle()
    assert picture.src.startswith("data:image/webp")
    assert decoded(picture.src).shape == (300, 700, 3)
    assert not picture.exact


def test_what_does_not_fit_into_a_page_leaves_the_memory_as_it_comes(tmp_path: Path) -> None:
    album = Album(tmp_path / "page.html", inside=40_000)
    encoded = [bytes([i]) * 9_000 for i in range(10)]
    pictures = []
    for i, data in enumerate(encoded):
        pictures.append(album.add_encoded(data, exact=True))
        album.add_data(f"probe-{i}", data[::-1])
        kept = sum(picture.data is not None for picture in pictures)
        assert kept == (i + 1 if i < 3 else 0)  # three take 36,000 bytes as text
        assert sum(script.text != "" for script in album._scripts) == kept
    assert [(tmp_path / str(picture.full)).read_bytes() for picture in pictures] == encoded
    files = {str(script.file) for script in album._scripts}
    assert len(files) == 10
    for i, script in enumerate(album._scripts):
        assert base64.b64encode(encoded[i]).decode() in (tmp_path / str(script.file)).read_text()


def test_beside_a_page_lies_what_it_shows_and_nothing_of_earlier_pages(tmp_path: Path) -> None:
    def make(*seeds: int, inside: int) -> list[Any]:
        album = Album(tmp_path / "page.html", inside)
        found = [album.add(np.random.default_rng(seed).random((200, 250, 3)).astype(np.float32)) for seed in seeds]
        found.append(album.add_data("probe-x", b"numbers"))  # type: ignore[arg-type]
        album.settle()
        return found

    folder = files_of(tmp_path / "page.html")
    *pictures, data = make(0, 1, inside=10_000)
    assert {path.name for path in folder.iterdir()} == {Path(item.full or "").name for item in pictures} | {
        Path(data.file).name
    }
    for seed, item in enumerate(pictures):
        alone = Album(tmp_path / "alone.html")
        same = alone.add(np.random.default_rng(seed).random((200, 250, 3)).astype(np.float32))
        assert (folder.parent / str(item.full)).read_bytes() == same.data
    assert max(decoded(pictures[0].src).shape) == 144
    (folder / "mine.png").write_bytes(b"x")
    (kept, _) = make(1, inside=10)
    assert {path.name for path in folder.iterdir()} >= {"mine.png", Path(kept.full or "").name}
    assert len(list(folder.iterdir())) == 3
    (folder / "mine.png").unlink()
    make(1, inside=10_000_000)
    assert not folder.exists()


def test_all_data_go_beside_a_page_that_pictures_have_filled(tmp_path: Path) -> None:
    """Pictures and data fit each by themselves, and not together."""
    album = Album(tmp_path / "page.html", inside=40_000)
    for i in range(2):
        album.add_encoded(bytes([i]) * 9_000, exact=True)
        album.add_data(f"probe-{i}", bytes([9 - i]) * 9_000)
    assert all(script.file is None for script in album._scripts)
    album.settle()
    for i, script in enumerate(album._scripts):
        assert not script.inside
        assert base64.b64encode(bytes([9 - i]) * 9_000).decode() in (tmp_path / str(script.file)).read_text()


def test_every_picture_that_fits_is_in_the_page(tmp_path: Path) -> None:
    album = Album(tmp_path / "page.html")
    pictures = [album.add(np.full((8, 8, 3), level, np.float32)) for level in (0.2, 0.6, 1.0)]
    album.settle()
    assert [int(decoded(picture.src)[0, 0, 0]) for picture in pictures] == [51, 153, 255]


@pytest.mark.parametrize("short", [0, 1])
def test_data_stay_in_a_page_that_holds_them_and_all_thumbnails(short: int, tmp_path: Path) -> None:
    def make(inside: int) -> tuple[list[Any], Any]:
        album = Album(tmp_path / "page.html", inside)
        found = [album.add(np.random.default_rng(seed).random((96, 96, 3)).astype(np.float32)) for seed in (0, 1)]
        data = album.add_data("probe-x", b"numbers")
        album.settle()
        return found, data

    thumbnails, _ = make(inside=0)
    needed = sum(len(picture.src) for picture in thumbnails) + len(base64.b64encode(b"numbers"))
    pictures, data = make(inside=needed - short)
    assert all(picture.full is not None for picture in pictures)
    assert data.inside == (not short)
