"""Maps of a view in colours: error, depth, normals."""

import cv2
import numpy as np

from novags.testbed.metrics.tone import affine_aligned

MAPS = {"magma": cv2.COLORMAP_MAGMA, "viridis": cv2.COLORMAP_VIRIDIS}
ERROR_CEILING = 0.25  # sRGB code units at the bright end of the error maps, the same in every report


def error_map(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute difference over the channels after alignment, magma, black = 0, bright = `ERROR_CEILING`."""
    error = np.abs(affine_aligned(image, truth) - truth).mean(-1)
    return colour_map(error / ERROR_CEILING, "magma")


def depth_map(z: np.ndarray, seen: np.ndarray, near: float, far: float) -> np.ndarray:
    """Depth [h,w] in viridis, near = dark, far = bright; grey where nothing is seen."""
    # A flat scene has near = far; any positive width shows it as one colour.
    coloured = colour_map(np.where(seen, z - near, 0) / max(far - near, 1e-6), "viridis")
    coloured[~seen] = 0.5
    return coloured


def normal_map(normals: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Unit normals [h,w,3] in camera axes (x right, y down, z forward) as colours; grey where nothing is seen.

    Red: to the right, green: upwards, blue: towards the camera, each from -1 (0) to 1 (1).
    """
    coloured = (0.5 + 0.5 * normals * (1.0, -1.0, -1.0)).astype(np.float32)
    coloured[~seen] = 0.5
    return np.clip(coloured, 0.0, 1.0)


def normals_of_depth(z: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Normals [h,w,3] in camera axes, facing the camera, of the surface at z-depth [h,w] seen by intrinsics [3,3].

    From central differences of the points; across an edge of the depth they mean nothing.
    """
    rows, columns = np.indices(z.shape)
    x, y = (columns + 0.5 - K[0, 2]) / K[0, 0], (rows + 0.5 - K[1, 2]) / K[1, 1]
    points = np.stack([x * z, y * z, z], -1).astype(np.float64)
    down, right = np.gradient(points, axis=(0, 1))
    normals = np.cross(down, right)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    # Where the depth is 0 all around, the points coincide and have no normal; any length but 0 keeps NaN out.
    found: np.ndarray = normals / np.where(length > 0, length, 1.0)
    return found


def colour_map(values: np.ndarray, name: str) -> np.ndarray:
    """[h,w] in 0..1 (clipped) -> float32 [h,w,3] of 8-bit codes by a perceptually uniform, colour-blind safe map."""
    codes = np.minimum(256 * np.clip(np.nan_to_num(values), 0.0, 1.0), 255).astype(np.uint8)
    return cv2.applyColorMap(codes, MAPS[name])[..., ::-1] / np.float32(255)
