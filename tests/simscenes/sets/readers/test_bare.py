"""Claims about how photographs of several sizes and lenses are brought together."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simscenes.sets.readers.bare import named_as_masks, picture_files, survey, without_masks


def picture(folder: Path, name: str, width: int, height: int, *, focal: int | None = None, maker: str = "") -> Path:
    """A picture, and in its header the focal length on 35 mm film and the maker of the camera."""
    exif = Image.Exif()
    if focal is not None:
        exif.get_ifd(0x8769)[0xA405] = focal
    if maker:
        exif[0x010F] = maker
    path = folder / name
    Image.fromarray(np.zeros((height, width, 3), np.uint8)).save(path, exif=exif)
    return path


def test_every_picture_gets_the_smallest_size_of_its_shape_that_covers_the_most_common_one(tmp_path: Path) -> None:
    sizes = [(64, 48), (64, 48), (128, 96), (32, 20), (40, 48)]
    files = [picture(tmp_path, f"{i}.jpg", *size) for i, size in enumerate(sizes)]
    found, common = survey(files, None)
    assert common == (64, 48)
    # 40 x 48 stands: it is turned, and 48 x 40 grows to 64 x 53. 32 x 20 has to reach 48 rows.
    assert [(one.size, one.turned) for one in found] == [
        ((64, 48), False), ((64, 48), False), ((64, 48), False), ((77, 48), False), ((64, 53), True)
    ]  # fmt: skip
    small, common = survey(files, 32)
    assert common == (32, 24)
    assert [one.size for one in small] == [(32, 24), (32, 24), (32, 24), (38, 24), (32, 27)]


def test_pictures_of_one_size_and_lens_share_a_camera_and_all_others_have_their_own(tmp_path: Path) -> None:
    files = [
        picture(tmp_path, "a.jpg", 64, 48, maker="A"),
        picture(tmp_path, "b.jpg", 64, 48, maker="B"),
        picture(tmp_path, "c.jpg", 64, 48, maker="A"),
        picture(tmp_path, "d.jpg", 48, 64, maker="A"),
        picture(tmp_path, "e.jpg", 66, 48, maker="A"),
    ]
    assert [one.camera for one in survey(files, None)[0]] == [0, 1, 0, 2, 3]


def test_a_focal_length_on_film_is_scaled_by_the_diagonal_of_the_picture(tmp_path: Path) -> None:
    """Film is 36 mm wide: in a picture of 360 px a millimetre has ten."""
    files = [picture(tmp_path, f"{i}.jpg", 360, 240, focal=50) for i in range(2)]
    assert [one.focal for one in survey(files, None)[0]] == pytest.approx([500.0] * 2, rel=1e-4)
    assert [one.focal for one in survey(files, 180)[0]] == pytest.approx([250.0] * 2, rel=1e-4)


def test_pictures_are_looked_for_in_the_folder_then_in_images_then_below_and_never_in_hidden_folders(
    tmp_path: Path,
) -> None:
    def found() -> list[str]:
        return [str(file.relative_to(tmp_path)) for file in picture_files(tmp_path)]

    for folder in ("day/.thumbnails", ".cache", "images"):
        (tmp_path / folder).mkdir(parents=True)
    picture(tmp_path / "day" / ".thumbnails", "a.jpg", 8, 6)
    picture(tmp_path / ".cache", "a.jpg", 8, 6)
    assert found() == []
    picture(tmp_path / "day", "b.jpg", 8, 6)
    picture(tmp_path / "day", "a.jpg", 8, 6)
    assert found() == ["day/a.jpg", "day/b.jpg"]
    picture(tmp_path / "images", "c.jpg", 8, 6)
    assert found() == ["images/c.jpg"]
    picture(tmp_path, "d.jpg", 8, 6)
    assert found() == ["d.jpg"]


def test_masks_among_photographs_are_told_by_their_names_folders_and_two_colours(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "masks").mkdir()
    photographs = [tmp_path / name for name in ("a.jpg", "b.jpg", "c.jpg", "mask_of_clay.jpg")]
    for file in photographs:
        Image.fromarray(rng.integers(0, 255, (24, 32, 3), np.uint8)).save(file)
    named = [
        picture(tmp_path, name, 32, 24)
        for name in ("a.jpg.png", "a_mask.png", "b.jpg.png", "c_mask.png", "masks/z.png")
    ]
    drawn = tmp_path / "y.png"
    Image.fromarray(np.repeat(np.eye(24, 32, dtype=np.uint8)[..., None] * 255, 3, 2)).save(drawn)
    assert named_as_masks([*photographs, *named, drawn]) == named
    assert without_masks([*photographs, *named, drawn]) == (photographs, [*named, drawn])
    assert without_masks([named[-1], drawn])[1] == []  # if all would be masks, none is
