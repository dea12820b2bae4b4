"""Claims about damaged COLMAP models: refused in pure Python, before pycolmap, which they make hang or fill memory."""

import shutil
from pathlib import Path
from struct import pack

import numpy as np
import pycolmap
import pytest

from simscenes import SparsePoints, orbit_rig, write_cameras
from simscenes.sets.readers import colmap
from simscenes.sets.readers.colmap_check import check_model, count_images

FILES = ("cameras", "frames", "images", "points3D", "rigs")


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    rng = np.random.default_rng(0)
    rig, xyz = orbit_rig(2, 40, 30, 55, radius=2.0), rng.normal(0, 0.3, (3, 3))
    points = SparsePoints.seen(rig, xyz, np.zeros((3, 3)), np.ones((2, 3), bool), exact=True)
    write_cameras(folder, ["a", "b c"], rig, points=points)
    return folder / "sparse" / "0"


@pytest.fixture(scope="module")
def text(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("text")
    pycolmap.Reconstruction(str(binary)).write_text(str(folder))
    return folder


@pytest.fixture
def model(binary: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(binary, tmp_path / "model"))


def test_whole_models_pass_with_the_names_of_their_images(binary: Path, text: Path) -> None:
    assert check_model(binary).names == {1: "a.png", 2: "b c.png"}
    assert check_model(text).names == {1: "a.png", 2: "b c.png"}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", ["binary", "text"])
def test_a_file_cut_anywhere_is_refused_by_name(
    kind: str, name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    source: Path = request.getfixturevalue(kind)
    copy = Path(shutil.copytree(source, tmp_path / "cut"))
    file = copy / f"{name}.{'bin' if kind == 'binary' else 'txt'}"
    whole = file.read_bytes()
    for size in range(len(whole)):
        file.write_bytes(whole[:size])
        # One line; where a cut leaves a whole file of less, another file refers to what is gone.
        with pytest.raises(ValueError, match=rf"^[^\n]*/(?:{'|'.join(FILES)})\.[^\n]*$"):
            check_model(copy)


@pytest.mark.parametrize("name", FILES)
def test_a_text_file_without_comments_is_whole_only_with_its_last_line_break(
    name: str, text: Path, tmp_path: Path
) -> None:
    copy = Path(shutil.copytree(text, tmp_path / "plain"))
    lines = (copy / f"{name}.txt").read_text().splitlines(keepends=True)
    plain = "".join(line for line in lines if not line.startswith("#"))
    (copy / f"{name}.txt").write_text(plain)
    assert len(check_model(copy).names) == 2
    (copy / f"{name}.txt").write_text(plain[:-2])
    with pytest.raises(ValueError, match=rf"{name}\.txt: is cut short: its last line does not end"):
        check_model(copy)


@pytest.mark.parametrize("place", [0, 1, -1])
def test_an_announced_number_counts_wherever_its_comment_stands(place: int, text: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(text, tmp_path / "announced"))
    lines = [line for line in (copy / "points3D.txt").read_text().splitlines() if not line.startswith("#")]
    for announced in (len(lines), len(lines) + 1):
        told = [*lines]
        told.insert(place if place >= 0 else len(lines), f"# Number of points: {announced}, mean track length: 2")
        (copy / "points3D.txt").write_text("".join(f"{line}\n" for line in told))
        if announced == len(lines):
            assert len(check_model(copy).names) == 2
        else:
            with pytest.raises(ValueError, match=rf"it announces {announced} points and has {len(lines)}"):
                check_model(copy)


def without_points(text: Path, folder: Path) -> Path:
    """The text model of no points, which are not in its pictures either."""
    copy = Path(shutil.copytree(text, folder / "no-points"))
    heads = [line for line in (copy / "images.txt").read_text().splitlines() if line.endswith(".png")]
    (copy / "images.txt").write_text("".join(f"{line}\n\n" for line in heads))
    (copy / "points3D.txt").write_text("")
    return copy


def test_a_file_of_points_without_a_byte_is_whole_where_no_picture_has_points(text: Path, tmp_path: Path) -> None:
    """Rationale: COLMAP's own instructions for known poses ask for one."""
    copy = without_points(text, tmp_path)
    assert check_model(copy).names == {1: "a.png", 2: "b c.png"}
    shutil.copyfile(text / "images.txt", copy / "images.txt")
    with pytest.raises(ValueError, match="that points3D does not have"):
        check_model(copy)


@pytest.mark.parametrize("points", ["given", "none"])
@pytest.mark.parametrize("blank", ["\n", " \n\n", "# a comment\n\n"])
def test_blank_lines_between_images_are_no_images(points: str, blank: str, text: Path, tmp_path: Path) -> None:
    copy = without_points(text, tmp_path) if points == "none" else Path(shutil.copytree(text, tmp_path / "given"))
    lines = [line for line in (copy / "images.txt").read_text().splitlines() if not line.startswith("#")]
    pairs = [f"{head}\n{seen}\n" for head, seen in zip(lines[::2], lines[1::2], strict=True)]
    (copy / "images.txt").write_text("".join(blank + pair for pair in pairs) + blank)
    assert check_model(copy).names == {1: "a.png", 2: "b c.png"}
    assert count_images(copy) == pycolmap.Reconstruction(str(copy)).num_images() == 2


def test_names_in_a_text_file_keep_their_spaces(text: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(text, tmp_path / "spaces"))
    (copy / "images.txt").write_text((copy / "images.txt").read_text().replace("b c.png", "b  c \t d.png"))
    assert check_model(copy).names[2] == "b  c \t d.png"


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("count", [2**64 - 1, 2**63, 10**12, 10**6])
def test_an_absurd_count_is_refused_before_anything_is_allocated(name: str, count: int, model: Path) -> None:
    file = model / f"{name}.bin"
    file.write_bytes(pack("<Q", count) + file.read_bytes()[8:])
    with pytest.raises(ValueError, match=rf"{name}\.bin: .*announces {count} .* bytes are left"):
        check_model(model)


def broken(old: bytes, new: bytes) -> object:
    def change(content: bytes) -> bytes:
        assert old in content
        return content.replace(old, new, 1)

    return change


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("images", broken(b"a.png\0", b"a.png."), "damaged|cut short"),
        ("images", broken(b"b c.png", b"a.png\0 "), "damaged|cut short"),
        ("images", broken(b"a.png", b"\xff.png"), "not UTF-8"),
        ("images", lambda c: c[:12] + pack("<d", np.nan) + c[20:], "pose that is not finite"),
        ("images", lambda c: c[:12] + bytes(32) + c[44:], "pose that is not finite or zero"),
        ("images", lambda c: c[:68] + pack("<I", 7) + c[72:], "camera 7"),
        ("cameras", lambda c: c[:12] + pack("<i", 99) + c[16:], "camera model 99"),
        ("cameras", lambda c: c[:16] + pack("<Q", 0) + c[24:], "camera of 0 x 30"),
        ("cameras", lambda c: c[:32] + pack("<d", np.inf) + c[40:], "not finite in camera"),
        ("points3D", lambda c: c[:16] + pack("<d", np.nan) + c[24:], "coordinates"),
        ("points3D", lambda c: c[:59] + pack("<I", 5) + c[63:], "image 5, which is not there"),
        ("points3D", lambda c: c[:63] + pack("<I", 500) + c[67:], "2D points that are not there"),
        ("points3D", lambda c: c[:8] + pack("<Q", 77) + c[16:], "points3D does not have"),
        ("cameras", lambda c: c + b"\0\0\0", "3 bytes after its last record"),
    ],
)
def test_what_refers_to_nothing_or_is_no_number_is_refused(name: str, change, message: str, model: Path) -> None:
    file = model / f"{name}.bin"
    file.write_bytes(change(file.read_bytes()))
    with pytest.raises(ValueError, match=message):
        check_model(model)


def test_pycolmap_never_sees_a_damaged_model(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (model / "points3D.bin").write_bytes(pack("<Q", 2**60))
    monkeypatch.setattr(pycolmap, "Reconstruction", lambda *_: pytest.fail("pycolmap was asked"))
    with pytest.raises(ValueError, match="points3D.bin"):
        colmap.read_reconstruction(model)


def test_a_model_with_a_part_missing_says_which(model: Path) -> None:
    (model / "images.bin").unlink()
    with pytest.raises(ValueError, match=r"lacks images\.bin; download"):
        check_model(model)


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_frames_that_place_an_image_elsewhere_than_images_do_are_refused(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Programs that know nothing of frames write images and points alone, turned and scaled."""
    source: Path = request.getfixturevalue(kind)
    model = Path(shutil.copytree(source, tmp_path / "model"))
    turned = pycolmap.Reconstruction(str(source))
    turned.transform(pycolmap.Sim3d(0.5, pycolmap.Rotation3d(np.array([0.5, 0.5, 0.5, 0.5])), np.array([0.0, 0, 1])))
    other = tmp_path / "turned"
    other.mkdir()
    (turned.write_binary if kind == "binary" else turned.write_text)(str(other))
    suffix = "bin" if kind == "binary" else "txt"
    for part in ("images", "points3D"):
        shutil.copyfile(other / f"{part}.{suffix}", model / f"{part}.{suffix}")
    with pytest.raises(
        ValueError, match=rf"images\.{suffix} and frames\.{suffix} .* differ for 2 of 2 \(a.png, b.*delete"
    ):
        colmap.read_reconstruction(model)
    for part in ("rigs", "frames"):
        (model / f"{part}.{suffix}").unlink()
    for number, image in colmap.read_reconstruction(model)[0].images.items():
        np.testing.assert_allclose(image.cam_from_world().matrix(), turned.images[number].cam_from_world().matrix())


def test_images_of_a_rig_with_two_cameras_agree_with_its_frames(tmp_path: Path) -> None:
    found, rig, frame = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1), pycolmap.Frame(frame_id=1, rig_id=1)
    beside = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.1, 0.2, 0.3])), np.array([5e6, 2.0, 3.0]))
    for i in (1, 2):
        found.add_camera(pycolmap.Camera.create_from_model_id(i, pycolmap.CameraModelId.SIMPLE_PINHOLE, 50.0, 40, 30))
    rig.add_ref_sensor(found.cameras[1].sensor_id)
    rig.add_sensor(found.cameras[2].sensor_id, beside)
    found.add_rig(rig)
    images = [pycolmap.Image(name=f"{i}.png", camera_id=i, image_id=i, frame_id=1) for i in (1, 2)]
    for image in images:
        frame.add_data_id(image.data_id)
    frame.rig_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.4, 0.5, 0.6])), np.array([7.0, 8.0, 9.0]))
    found.add_frame(frame)
    for image in images:
        found.add_image(image)
    found.register_frame(1)
    found.write_binary(str(tmp_path))
    assert len(colmap.read_reconstruction(tmp_path)[1]) == 2


@pytest.mark.parametrize("frames", [True, False])
def test_images_whose_poses_are_written_in_six_digits_agree_with_frames(
    frames: bool, text: Path, tmp_path: Path
) -> None:
    model = Path(shutil.copytree(text, tmp_path / "model"))
    for part in () if frames else ("rigs", "frames"):
        (model / f"{part}.txt").unlink()
    lines = (model / "images.txt").read_text().splitlines()
    for k, line in enumerate(lines):
        if line.endswith(".png"):
            number, *words = line.split(maxsplit=8)
            lines[k] = " ".join([number, *(f"{-float(w):.6f}" for w in words[:4]), *words[4:]])  # -q turns as q does
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    assert len(colmap.read_reconstruction(model)[1]) == 2
