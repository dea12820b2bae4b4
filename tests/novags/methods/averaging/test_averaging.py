"""The average over views against a world of formulas: what it shows, how noisy it is, whom it believes."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from novags.methods.averaging.scene import AveragedScene, _apart, average
from novags.methods.averaging.surface import SurfaceCamera, rays_of, same_depth, seen_together
from novags.methods.averaging.warp import Rules, _finest, _keys, _places, _steps, moved, warp
from novags.splats import Views

Array = NDArray[np.float64]
HEIGHT, WIDTH, INNER = 28, 36, 6  # px, px, samples along a side of a pixel
SIZE = HEIGHT, WIDTH  # neither square nor of square pixels: rows are no columns
STRICT, LENIENT, EVERY = Rules(coarsest=3.0, mixed=False), Rules(), np.arange(HEIGHT * WIDTH)
BOX = np.array([[-0.35, -0.35, 0.0], [0.35, 0.35, 0.7]])


def looking(eye: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0.2)) -> Array:
    """World-to-camera matrix, OpenCV axes, world z up."""
    forward = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation, -rotation @ np.asarray(eye, float)
    return found


@dataclass(frozen=True)
class World:
    """The ground z = 0, with or without a box on it, in a pattern without sharp edges."""

    box: bool = True
    frequency: float = 4.0  # radians per unit of length
    K = np.array([[40.0, 0, 19.2], [0, 37.0, 13.1], [0, 0, 1]])

    def hit(self, viewmat: Array, points: Array) -> tuple[Array, Array, Array]:
        """Of rays through image points [..., 2]: z-depth, place in the world, normal."""
        rays = np.concatenate([points, np.ones_like(points[..., :1])], -1) @ np.linalg.inv(self.K).T
        direction, eye = rays @ viewmat[:3, :3], -viewmat[:3, :3].T @ viewmat[:3, 3]
        with np.errstate(divide="ignore"):
            depth = np.where(direction[..., 2] < 0, -eye[2] / direction[..., 2], np.inf)
            normal = np.broadcast_to([0.0, 0.0, 1.0], direction.shape).copy()
            if self.box:
                first, last = np.sort((BOX[:, None] - eye) / direction.reshape(1, -1, 3), 0)
                enter, leave, axis = first.max(-1), last.min(-1), first.argmax(-1)
                met = ((enter < leave) & (enter > 0) & (enter < depth.ravel())).reshape(depth.shape)
                depth = np.where(met, enter.reshape(depth.shape), depth)
                facing = -np.sign(direction) * np.eye(3)[axis].reshape(direction.shape)
                normal = np.where(met[..., None], facing, normal)
        return depth, eye + np.where(np.isfinite(depth), depth, 0.0)[..., None] * direction, normal

    def colour(self, place: Array) -> Array:
        """Linear light at places [..., 3], the same from everywhere."""
        phase = self.frequency * place @ np.array([[1.0, 0.4, -0.6], [-0.5, 1.0, 0.8], [0.9, -0.7, 0.5]])
        return np.asarray(0.5 + 0.3 * np.sin(phase))

    def camera(self, viewmat: Array) -> SurfaceCamera:
        """The camera with its surface, from depth and normals at pixel centres as a rendered set has them."""
        depth, _, normal = self.hit(viewmat, _centres())
        return SurfaceCamera.of(viewmat, self.K, depth.astype(np.float32), normal.astype(np.float32))

    def picture(self, viewmat: Array) -> Array:
        """Linear light [HEIGHT, WIDTH, 3], averaged over each pixel; the background is black."""
        ticks = (np.arange(INNER) + 0.5) / INNER - 0.5
        total = np.zeros((*SIZE, 3))
        for dx in ticks:
            for dy in ticks:
                depth, place, _ = self.hit(viewmat, _centres() + (dx, dy))
                total += np.where(np.isfinite(depth)[..., None], self.colour(place), 0.0)
        return total / INNER**2


def _centres() -> Array:
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return np.stack([x, y], -1)


AROUND = [looking((1.2 * np.cos(a), 1.2 * np.sin(a), 2.1 + 0.1 * k)) for k, a in enumerate(np.linspace(0, 1.5, 6))]
TARGET = looking((0.9, 0.8, 2.3))


def gathered(world: World, exposures: Array | None = None, variances: Array | None = None) -> AveragedScene:
    """Six exposures of a world, without noise and with equal weights unless others are given."""
    pictures = np.stack([world.picture(pose) for pose in AROUND]) if exposures is None else exposures
    sources = [world.camera(pose) for pose in AROUND]
    return AveragedScene(
        sources=sources, exposures=pictures, variances=np.ones_like(pictures) if variances is None else variances,
        known=[*sources, world.camera(TARGET)], rules=STRICT, enhance=lambda image, _: image,
    )  # fmt: skip


def inner(camera: SurfaceCamera) -> NDArray[np.bool_]:
    return (camera.whole & (camera.inverse_depth > 0)).ravel()


def test_without_noise_the_average_is_the_picture() -> None:
    """A warp by bilinear interpolation loses several times as much."""
    world = World(frequency=8.0)
    scene, truth = gathered(world), world.picture(TARGET).reshape(-1, 3)
    target = world.camera(TARGET)
    errors = {}
    for kernel in ("cubic", "linear"):
        found = average(target, scene.sources, scene.exposures, scene.variances, replace(STRICT, kernel=kernel))
        judged = inner(target) & (found.views > 0)
        assert judged.mean() > 0.6
        errors[kernel] = np.sqrt(np.mean((found.mean - truth)[judged] ** 2))
    assert errors["cubic"] < 0.004  # of a pattern whose standard deviation is 0.21
    assert errors["linear"] > 2 * errors["cubic"]


def test_a_finer_picture_is_averaged_over_the_whole_pixel() -> None:
    """From nearer by, a pattern of six pixels a period must not be picked at points."""
    world, near = World(box=False, frequency=22.0), looking((0.55, 0.0, 0.65), (0, 0, 0))
    far = looking((2.2, 0.0, 2.6), (0, 0, 0))
    target, source, truth = world.camera(far), world.camera(near), world.picture(far).reshape(-1, 3)
    exposure = world.picture(near)[None]
    found = average(target, [source], exposure, np.ones_like(exposure), STRICT)
    seen = found.views > 0
    assert seen.sum() > 20
    assert np.abs(found.mean - truth)[seen].max() < 0.02
    assert found.variance[seen].max() < 0.2  # of 16 pixels or so


def test_the_variance_is_one_over_the_sum_of_inverse_variances() -> None:
    """Measured over draws, within five standard errors; other weights leave more than that, and would be seen."""
    world, rng, rows = World(), np.random.default_rng(0), EVERY[::5]
    scene, target = gathered(world), world.camera(TARGET)
    sigma = np.array([0.02, 0.05, 0.1, 0.2, 0.03, 0.4])[:, None, None, None] * (0.5 + np.stack(list(scene.exposures)))
    found = average(target, scene.sources, scene.exposures, sigma**2, STRICT, rows)
    inverse = np.zeros_like(found.mean)
    for source, sd in zip(scene.sources, sigma, strict=True):
        weights, views = warp(target, source, rows, STRICT)
        inverse[views] += 1 / ((weights.toarray() ** 2) @ (sd**2).reshape(-1, 3))[views]
    seen = found.views > 0
    assert np.allclose(found.variance[seen], 1 / inverse[seen], rtol=1e-9)
    assert np.isinf(found.variance[~seen]).all()

    def ratios(weighted: Array) -> Array:
        drawn = (sigma * rng.standard_normal(sigma.shape) for _ in range(20))
        means = (average(target, scene.sources, noise, weighted, STRICT, rows).mean for noise in drawn)
        return np.array([np.mean(mean[seen] ** 2 / found.variance[seen]) for mean in means])

    good, equal = ratios(sigma**2), ratios(np.ones_like(sigma))
    assert abs(good.mean() - 1) < 5 * good.std(ddof=1) / np.sqrt(len(good))
    assert equal.mean() - 1 > 10 * equal.std(ddof=1) / np.sqrt(len(equal))


def test_two_exposures_from_the_same_place_are_weighted_by_hand() -> None:
    camera = World().camera(TARGET)
    exposures = np.stack([np.full((*SIZE, 3), value) for value in (2.0, 7.0)])
    variances = np.stack([np.full((*SIZE, 3), value) for value in (1.0, 4.0)])
    found = average(camera, [camera, camera], exposures, variances, LENIENT)
    assert np.allclose(found.mean, (2.0 / 1 + 7.0 / 4) / (1 / 1 + 1 / 4))
    assert np.allclose(found.variance, 1 / (1 / 1 + 1 / 4))
    assert (found.views == 2).all()


def test_what_a_view_does_not_see_does_not_leak() -> None:
    """The box shines in every exposure: no pixel of the ground alone may take any of that, and the other way round."""
    world = World()
    target = world.camera(TARGET)
    ground = [world.hit(pose, _centres())[2][..., 2] > 0.5 for pose in (*AROUND, TARGET)]
    on_box = [world.hit(pose, _centres())[1][..., 2] > 1e-6 for pose in (*AROUND, TARGET)]
    shining = np.stack([np.where(box[..., None], 1000.0, 0.0) * np.ones(3) for box in on_box[:-1]])
    found = average(target, [world.camera(p) for p in AROUND], shining, np.ones_like(shining), STRICT)
    judged = inner(target) & (found.views > 0)
    expected = np.where(on_box[-1].ravel(), 1000.0, 0.0)
    assert np.allclose(found.mean[judged], expected[judged, None])
    assert 50 < (judged & on_box[-1].ravel()).sum() < (judged & ground[-1].ravel()).sum()
    hidden = average(target, [world.camera(looking((-2.0, -1.6, 1.2)))], shining[:1], shining[:1] + 1, STRICT)
    assert (hidden.views > 0).mean() < 0.75  # the far sides of the box, and its shadow


def test_less_than_half_of_the_kernel_on_the_surface_is_not_enough() -> None:
    """In the corner of a surface, two fifths of a pixel away from what shows it alone, a third of it is left."""
    depth, facing = np.full(SIZE, 2.0), np.broadcast_to([0.0, 0.0, -1.0], (*SIZE, 3))
    target = SurfaceCamera.of(np.eye(4), World.K, depth, facing)
    corner = depth.copy()
    corner[8:], corner[:, 8:] = 5.0, 5.0
    moved = World.K + np.array([[0, 0, 0.45], [0, 0, 0.45], [0, 0, 0]])
    source = SurfaceCamera.of(np.eye(4), moved, corner, facing)
    rows = np.array(
        [6 * WIDTH + 6, 6 * WIDTH + 4, 4 * WIDTH + 6, 4 * WIDTH + 4]
    )  # of whole pixels up to row and column 6
    assert warp(target, source, rows, STRICT)[1].tolist() == [False, True, True, True]


def test_holes_are_counted_and_take_the_colour_beside_them() -> None:
    world = World()
    scene = gathered(world)
    scene.sources, scene.exposures = scene.sources[:1], list(scene.exposures)[:1]
    scene.variances = list(scene.variances)[:1]
    views = Views(torch.tensor(TARGET[None]).float(), torch.tensor(world.K[None]).float(), WIDTH, HEIGHT)
    image, alpha, depth = scene.render(views)
    seen = scene.averaged(world.camera(TARGET)).views.reshape(SIZE) > 0
    holes = int((~seen).sum())
    assert 20 < holes < 400
    assert scene.facts() == {"exposures": 1, "holes": holes, "pixels": HEIGHT * WIDTH}
    assert (image > 0.1).all()
    surface = np.isfinite(world.hit(TARGET, _centres())[0])
    assert np.array_equal(alpha[0].numpy() > 0, seen & surface)
    true = world.hit(TARGET, _centres())[0]
    assert np.allclose(depth[0].numpy()[seen & surface], true[seen & surface], rtol=1e-5)


def test_a_plane_seen_from_the_side_is_the_same_plane_in_every_pixel() -> None:
    """Until it is seen at an angle whose cosine is below 0.02."""
    normal, distance = np.array([-np.sin(1.25), 0.0, -np.cos(1.25)]), 2.0
    K = np.array([[40.0, 0, 16], [0, 37.0, 13], [0, 0, 1]])
    rays = rays_of(K, 7, 8)
    slope = rays @ normal
    cosine = -slope / np.linalg.norm(rays, axis=-1)
    assert cosine.max() < 0.15
    depth = np.where(slope < 0, -distance / slope, np.inf)
    camera = SurfaceCamera.of(np.eye(4), K, depth, np.broadcast_to(normal, (7, 8, 3)))
    seen = cosine > 0.02
    assert seen.mean() > 0.3
    np.testing.assert_allclose(camera.planes[seen], np.broadcast_to(-normal / distance, camera.planes.shape)[seen])


def test_a_plane_along_the_ray_is_taken_as_facing_the_camera_at_its_depth() -> None:
    K = np.array([[40.0, 0, 16], [0, 37.0, 13], [0, 0, 1]])
    along = np.cross(rays_of(K, 5, 6), [0.0, 1.0, 0.0])
    camera = SurfaceCamera.of(np.eye(4), K, np.full((5, 6), 2.0), along / np.linalg.norm(along, axis=-1, keepdims=True))
    np.testing.assert_allclose(camera.planes, np.broadcast_to([0.0, 0.0, 0.5], (5, 6, 3)))


def test_where_all_exposures_are_too_coarse_they_are_used_all_the_same() -> None:
    world = World(box=False)
    near, far = looking((0.55, 0.0, 0.65), (0, 0, 0)), looking((2.2, 0.0, 2.6), (0, 0, 0))
    scene = gathered(world)
    exposure = world.picture(far)[None]
    scene.sources, scene.exposures, scene.variances = [world.camera(far)], exposure, np.ones_like(exposure)
    target = world.camera(near)
    strict = average(target, scene.sources, exposure, np.ones_like(exposure), STRICT)
    assert (strict.views == 0).mean() > 0.5
    found = scene.averaged(target)
    assert (found.views == 1).all()
    assert np.abs(found.mean - world.picture(near).reshape(-1, 3)).max() < 0.1


def test_cubic_convolution_finds_every_parabola_exactly() -> None:
    """Keys 1981, section 3: with a = -1/2 the error is of third order, for no other kernel of its kind is it."""
    taps = np.arange(-1, 3)
    for x in np.linspace(0, 1, 11):
        weights = _keys(x - taps)
        assert [weights @ taps**power for power in (0, 1, 2)] == pytest.approx([1.0, x, x**2], abs=1e-12)


def test_a_pixel_is_as_coarse_as_in_its_coarsest_direction() -> None:
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    homography = turn @ np.diag([3.0, 0.25, 1.0]) @ turn.T
    np.testing.assert_allclose(_finest(homography[None], np.array([[5.0, 2.0]])), [0.25])


def test_steps_are_what_image_points_move_along_x_and_along_y() -> None:
    """Independent reference: central differences, through a homography with a perspective."""
    homography = np.array([[[2.0, 0.7, 3.0], [-0.3, 0.5, 1.0], [0.01, -0.03, 1.1]]])
    centre, h = np.array([[7.5, 4.5]]), 1e-4
    for axis, found in enumerate(_steps(homography, centre)[0]):
        shift = h * np.eye(2)[axis]
        (after, _), (before, _) = moved(homography, centre + shift), moved(homography, centre - shift)
        assert found == pytest.approx(np.linalg.norm(after - before) / (2 * h), rel=1e-6)


def test_depths_agree_by_their_ratio_whatever_the_unit_of_length() -> None:
    for unit in (0.01, 1.0, 100.0):
        expected, found = np.array([1.0, 1.0, -1.0, 0.0, 0.0]), np.array([1.009, 1.011, 1.0, 0.0, 0.001])
        agree = same_depth(expected / unit, found / unit, 0.01)
        assert agree.tolist() == [True, False, False, True, False]


@pytest.mark.parametrize("scale", [1.0, 1.5, 3.0])
def test_samples_of_a_pixel_and_the_areas_of_finer_ones_together_spread_as_the_pixel_does(scale: float) -> None:
    """Variances of box filters: that of a pixel is 1 / 12, in pixels of the finer picture scale**2 / 12."""
    homography, centre = np.diag([scale, 0.5 * scale + 0.5, 1.0])[None], np.array([[7.5, 4.5]])
    steps = np.array([[scale, 0.5 * scale + 0.5]])
    places = _places(centre, steps, homography, 8)[0]
    np.testing.assert_allclose(places.mean(0), (centre * steps)[0], rtol=1e-12)
    np.testing.assert_allclose(12 * places.var(0) + 1, steps[0] ** 2, rtol=0.02)  # eight samples are no integral


@pytest.mark.parametrize("angle", [1e-7, 0.3, 2.0, 3.1])
def test_how_far_cameras_are_apart_is_their_angle_and_the_distance_of_their_centres(angle: float) -> None:
    axis, one, other = np.array([0.36, 0.48, 0.8]), looking((1, 2, 3)), np.eye(4)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    other[:3, :3] = (np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross) @ one[:3, :3]  # Rodrigues
    other[:3, 3] = -other[:3, :3] @ np.array([1, 2, 5])
    assert _apart(one, other) == pytest.approx((angle, 2.0), rel=1e-6)


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
@pytest.mark.parametrize(("turn", "nearest"), [(0.2, 0), (0.4, 1)])
def test_the_enhancement_is_that_of_the_nearest_camera_whatever_the_unit_of_length(
    unit: float, turn: float, nearest: int
) -> None:
    """One camera stands where the target does but is turned, the other looks alike, a quarter of the reach away."""

    def camera(turn: float, place: float) -> SurfaceCamera:
        viewmat = np.eye(4)
        viewmat[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
        viewmat[:3, 3] = -viewmat[:3, :3] @ [place * unit, 0, 0]
        return SurfaceCamera(viewmat, World.K, (4, 4), 0.01, lambda: np.zeros((4, 4, 3)))

    sources, target = [camera(turn, 0.0), camera(0.0, 1 / 3)], camera(0.0, 0.0)
    known = [camera(0.0, -4 / 3), *sources, target, camera(0.0, 1.0)]  # their mean is the target's place
    pictures, seen = np.ones((2, 4, 4, 3)), []
    scene = AveragedScene(
        sources=sources, exposures=pictures, variances=pictures, known=known, rules=LENIENT,
        enhance=lambda image, view: seen.append(view) or image,
    )  # fmt: skip
    viewmats, Ks = (torch.from_numpy(matrix)[None].float() for matrix in (target.viewmat, World.K))
    scene.render(Views(viewmats, Ks, 4, 4))
    assert seen == [nearest]


def test_a_camera_between_the_known_ones_sees_their_surface() -> None:
    world, place = World(), looking((0.7, 0.9, 2.2))
    scene = gathered(world)
    found, true = seen_together(scene.known, place, world.K, HEIGHT, WIDTH), world.camera(place)
    judged = inner(true) & inner(found)
    assert judged.mean() > 0.6
    assert np.quantile(np.abs(found.inverse_depth / true.inverse_depth - 1).ravel()[judged], 0.98) < 0.01
    error = (scene.averaged(found).mean - world.picture(place).reshape(-1, 3))[judged]
    assert np.sqrt(np.mean(error**2)) < 0.02


def test_the_background_turns_with_the_camera_and_has_no_parallax() -> None:
    """Rationale: its z-depth is infinite, and the same direction is elsewhere in another picture."""
    world = World(box=False)
    pose = looking((0.0, 0.0, 1.0), (1.0, 0.0, 1.1))
    turned = looking((0.5, 0.4, 1.3), (1.5, 0.6, 1.4))
    source, target = world.camera(pose), world.camera(turned)
    rays = np.concatenate([_centres(), np.ones((*SIZE, 1))], -1) @ np.linalg.inv(world.K).T

    def sky(viewmat: Array) -> Array:
        direction = rays @ viewmat[:3, :3]
        return 0.5 + 0.4 * np.sin(3 * direction / np.linalg.norm(direction, axis=-1, keepdims=True))

    empty = inner_of_background(target)
    found = average(target, [source], sky(pose)[None], np.ones((1, *SIZE, 3)), STRICT)
    judged = empty & (found.views > 0)
    assert judged.sum() > 100
    assert np.abs(found.mean - sky(turned).reshape(-1, 3))[judged].max() < 5e-3


def inner_of_background(camera: SurfaceCamera) -> NDArray[np.bool_]:
    return (camera.whole & (camera.inverse_depth == 0)).ravel()


def test_rows_sum_to_one_or_to_nothing() -> None:
    world = World()
    for rules in (STRICT, LENIENT, replace(STRICT, kernel="linear")):
        weights, seen = warp(world.camera(TARGET), world.camera(AROUND[2]), EVERY, rules)
        assert np.allclose(weights.sum(1), seen)


def test_of_two_surfaces_that_fall_onto_one_pixel_the_nearer_is_seen() -> None:
    K, wide = np.diag([8.0, 8.0, 1.0]), np.diag([2.0, 2.0, 1.0])
    K[:2, 2], wide[:2, 2] = 4.0, 1.0  # 8 x 8 pixels, of which the other camera has 2 x 2
    for y, x in ((0, 0), (1, 1), (2, 1)):
        depth = np.full((8, 8), 4.0)
        depth[y::4, x::4] = 2.0  # one in each of the large pixels
        known = SurfaceCamera.of(np.eye(4), K, depth, np.broadcast_to([0.0, 0.0, -1.0], (8, 8, 3)))
        np.testing.assert_allclose(seen_together([known], np.eye(4), wide, 2, 2).inverse_depth, 1 / 2.0)


def test_a_saved_average_holds_every_exposure_with_its_camera_and_surface(tmp_path: Path) -> None:
    scene = gathered(World())
    scene.save(tmp_path)
    with np.load(tmp_path / "scene" / "exposures.npz") as found:
        np.testing.assert_array_equal(found["viewmats"], np.stack(AROUND))
        np.testing.assert_array_equal(found["Ks"], np.stack([World.K] * 6))
        np.testing.assert_allclose(found["planes"], np.stack([c.planes for c in scene.sources]), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found["exposures"], list(scene.exposures), rtol=1e-6)
        np.testing.assert_allclose(found["variances"], list(scene.variances), rtol=1e-6)
