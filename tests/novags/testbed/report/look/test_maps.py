"""Claims about maps: depth, errors and normals as colours."""

import numpy as np
import pytest

from novags.testbed.report.look.maps import (
    ERROR_CEILING,
    colour_map,
    depth_map,
    error_map,
    normal_map,
    normals_of_depth,
)


def test_normals_of_a_tilted_plane_are_its_own_and_face_the_camera() -> None:
    normal = np.array([0.3, -0.5, -0.8])
    normal /= np.linalg.norm(normal)
    K = np.array([[40.0, 0, 15.2], [0, 44.0, 11.1], [0, 0, 1]])
    rows, columns = np.indices((24, 32))
    rays = np.stack([(columns + 0.5 - 15.2) / 40, (rows + 0.5 - 11.1) / 44, np.ones((24, 32))], -1)
    z = (normal @ [0, 0, 5.0]) / (rays @ normal)  # n . (z ray) = n . p
    found = normals_of_depth(z, K)
    assert found.reshape(-1, 3) == pytest.approx(np.broadcast_to(normal, (24 * 32, 3)), abs=1e-2)
    assert found[1:-1, 1:-1].reshape(-1, 3) == pytest.approx(np.broadcast_to(normal, (22 * 30, 3)), abs=2e-3)


def test_no_depth_makes_no_normal_and_a_wall_ahead_is_blue() -> None:
    K = np.array([[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]])
    assert not np.isnan(normals_of_depth(np.zeros((16, 16)), K)).any()
    seen = np.ones((16, 16), bool)
    seen[0, 0] = False
    picture = normal_map(normals_of_depth(np.full((16, 16), 2.0), K), seen)
    assert picture[5, 5] == pytest.approx([0.5, 0.5, 1.0])
    assert picture[0, 0] == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.parametrize("name", ["magma", "viridis"])
def test_colour_maps_are_those_of_matplotlib_in_every_8_bit_code(name: str) -> None:
    """Rationale: pages made before must show the same colours."""
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed (scripts/setup dev)")
    values = np.append(np.linspace(-0.1, 1.1, 5000), np.arange(257) / 256).reshape(1, -1).astype(np.float32)
    theirs = np.rint(255 * matplotlib.colormaps[name](np.clip(values, 0, 1))[..., :3])
    assert np.array_equal(np.rint(255 * colour_map(values, name)), theirs)
    assert len(np.unique(theirs.reshape(-1, 3), axis=0)) > 200


def test_error_maps_are_black_where_right_and_bright_at_the_ceiling() -> None:
    truth = np.random.default_rng(0).uniform(0.3, 0.6, (16, 16, 3)).astype(np.float32)
    wrong = truth.copy()
    wrong[0, 0] += 2 * ERROR_CEILING
    picture = error_map(wrong, truth).mean(-1)
    assert picture[0, 0] > 0.6
    assert np.median(picture) < 0.2
    assert error_map(truth, truth).max() < 0.02


def test_depth_is_grey_where_nothing_is_seen() -> None:
    z = np.linspace(1, 2, 16, dtype=np.float32).reshape(4, 4)
    seen = np.ones((4, 4), bool)
    seen[0, 0] = False
    z[0, 0] = np.inf
    picture = depth_map(z, seen, 1.0, 2.0)
    assert (picture[0, 0] == 0.5).all()
    assert picture[3, 3, 1] > picture[0, 1, 1]  # viridis ends in yellow and begins in purple
