"""Claims about features as COLMAP gets them."""

from pathlib import Path

import numpy as np
from PIL import Image

from novags.cameras.motion.colmap import LOWER_EDGE, detect, extraction, quiet, verification


def test_features_in_the_last_row_whose_descriptors_are_undefined_are_left_out(corner, tmp_path: Path) -> None:
    import pycolmap

    scene = corner(9, 200, 150)
    Image.fromarray(scene.pictures[4]).save(tmp_path / "a.png")
    with quiet(pycolmap), pycolmap.Database.open(tmp_path / "found.db") as found:
        options = extraction(pycolmap, max_features=4096, peak_threshold=0.0067, first_octave=-1, threads=1)
        extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
        pycolmap.import_images(tmp_path / "found.db", tmp_path, pycolmap.CameraMode.SINGLE, ["a.png"])
        assert detect(pycolmap, found, "a.png", tmp_path, extractor) == 1
        image = found.read_image_with_name("a.png").image_id
        kept, described = found.read_keypoints(image), np.asarray(found.read_descriptors(image).data)
        points, descriptors = extractor.extract(pycolmap.Bitmap.read(tmp_path / "a.png", False))
    places = np.array([(p.x, p.y) for p in points], np.float32)
    inner = places[:, 1] < 150 - LOWER_EDGE * np.array([p.compute_scale() for p in points])
    assert 0 < (~inner).sum() < 0.02 * len(inner)
    assert np.array_equal(kept[:, :2], places[inner])
    # Rows of defined descriptors have unit length, in steps of 1/512, in the square roots that COLMAP takes.
    assert np.array_equal(described, descriptors.data[inner])
    assert np.abs(np.linalg.norm(described / 512.0, axis=1) - 1).max() < 0.02


def test_any_seed_of_a_run_is_one_for_colmap() -> None:
    import pycolmap

    for seed, known in ((7, 7), (2**31 + 7, 7), (2**64 - 1, 2**31 - 1)):
        options = verification(pycolmap, min_matches=15, max_error=4.0, seed=seed)
        assert options.ransac.random_seed == known
