"""Consistency-aware optimisation: depth-guided reprojection and its confidence-weighted loss (paper, section 4.5).

The subscript `t` marks the target view, whose pixels are compared, `s` the source view, whose colours are brought over.
Pixel coordinates are (x, y) with centres at +0.5; depths are z-depths in their own camera, 0 or less where unknown.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.nova.config import ConsistencyConfig
from novags.splats.training.companion import masked_step, pack, unpack
from novags.splats.training.fit import Step
from novags.splats.training.flags import Flags
from novags.splats.training.guard import require_finite
from novags.splats.views import Views

FARTHEST = 1e10  # world units: the far plane of `rasterize`


@dataclass(frozen=True)
class Pinhole:
    """One pinhole view: viewmat [4, 4] world to camera, K [3, 3]."""

    viewmat: Tensor
    K: Tensor

    @staticmethod
    def of(views: Views, index: int) -> "Pinhole":
        """View number `index` of a set."""
        return Pinhole(views.viewmats[index], views.Ks[index])


class ConfidenceNet(nn.Module):
    """Reliability of reprojected pixels from the warped source and the target (equation 11; supplement B.4)."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(6, 16, 3, padding=1),
            nn.InstanceNorm2d(16),
            nn.LeakyReLU(0.2),
            nn.Conv2d(16, 16, 3, padding=1),
            nn.Conv2d(16, 1, 1),
        )

    def forward(self, warped: Tensor, target: Tensor) -> Tensor:
        """warped, target: [H, W, 3]. Returns C in (0, 1), [H, W]."""
        pair = torch.cat([warped, target], -1).movedim(-1, 0)
        # One sigmoid, though equation and supplement each mention it: two would confine C to (0.5, 0.73).
        return torch.sigmoid(self.layers(pair[None]))[0, 0]


def _rays(height: int, width: int, K: Tensor) -> Tensor:
    """Camera-space points at depth 1 of all pixel centres, [H, W, 3]."""
    y = torch.arange(height, dtype=K.dtype, device=K.device) + 0.5
    x = torch.arange(width, dtype=K.dtype, device=K.device) + 0.5
    pixels = torch.stack([x.expand(height, width), y[:, None].expand(height, width)], -1)
    return torch.cat([pixels, torch.ones_like(pixels[..., :1])], -1) @ _inverse(K).T


def _inverse(matrix: Tensor) -> Tensor:
    """The inverse; `torch.linalg.inv` has a GPU waited for to know that there is one, as there is of any camera."""
    found: Tensor = torch.linalg.inv_ex(matrix).inverse
    return found


def _move(points: Tensor, origin: Pinhole, goal: Pinhole) -> Tensor:
    """Points [..., 3] from the camera frame of `origin` to the frame of `goal`."""
    change = goal.viewmat @ _inverse(origin.viewmat)
    return points @ change[:3, :3].T + change[:3, 3]


def _project(points: Tensor, K: Tensor) -> Tensor:
    """Camera-space points [..., 3] to pixels [..., 2]."""
    # Floor: points beside or behind the camera divide by zero; the mask drops them, but NaN gradients would survive it.
    return (points @ K.T)[..., :2] / points[..., 2:].clamp_min(1e-6)


def _sample(image: Tensor, pixels: Tensor) -> Tensor:
    """Bilinear samples [H, W, D] of image [h, w, D] at pixels [H, W, 2], border colours outside."""
    size = pixels.new_tensor([image.shape[1], image.shape[0]])
    grid = 2 * pixels / size - 1
    found = F.grid_sample(
        image.movedim(-1, 0)[None], grid[None], mode="bilinear", padding_mode="border", align_corners=False
    )
    return found[0].movedim(0, -1)


def reproject(
    source: Tensor,
    depth_t: Tensor,
    depth_s: Tensor,
    camera_t: Pinhole,
    camera_s: Pinhole,
    occlusion_tolerance: float = 0.1,
) -> tuple[Tensor, Tensor]:
    """Warp a source image into the target view by the rendered depths, with the mask of reliable pixels (equation 10).

    Target pixels are lifted by `depth_t` and projected into the source, where colour and source depth are read. That
    source depth, brought back into the target frame, is z_t; a pixel counts if |depth_t - z_t| / z_t < tolerance.

    Args:
        source: [H, W, 3], colours of the source view.
        depth_t: [H, W] of the target; the result is differentiable in it.
        depth_s: [h, w] of the source; a constant.
        camera_t: Target camera.
        camera_s: Source camera.
        occlusion_tolerance: Relative depth difference above which a pixel counts as occluded.

    Returns:
        warped [H, W, 3] and M_geo [H, W] bool: positive depth in both cameras, inside the source frame, not occluded.
    """
    height, width = depth_t.shape
    # Infinite, NaN or beyond the rasteriser's far plane is as unknown as 0: the mask would drop such a pixel, but not
    # the NaN that it leaves in the loss and in every gradient (where torch's grid_sample crashes on its way back).
    depth_t = torch.where(depth_t.abs() < FARTHEST, depth_t, 0.0)
    points = _move(_rays(height, width, camera_t.K) * depth_t[..., None], camera_t, camera_s)
    pixels = _project(points, camera_s.K)
    seen = _sample(depth_s.detach()[..., None], pixels.detach())[..., 0]
    lifted = torch.cat([pixels.detach(), torch.ones_like(seen[..., None])], -1) @ _inverse(camera_s.K).T
    z_t = _move(lifted * seen[..., None], camera_s, camera_t)[..., 2]
    size = pixels.new_tensor([depth_s.shape[1], depth_s.shape[0]])
    # Between the outermost pixel centres, where interpolation has support; the slack tolerates float32 rounding of a
    # camera warped onto itself.
    inside = ((pixels > 0.499) & (pixels < size - 0.499)).all(-1)
    positive = (depth_t > 0) & (points[..., 2] > 0) & (seen > 0)
    # False for z_t <= 0 too.
    visible = (depth_t - z_t).abs() < occlusion_tolerance * z_t
    return _sample(source, pixels), inside & positive & visible


def consistency_loss(
    warped: Tensor, target: Tensor, confidence: Tensor, mask: Tensor, confidence_weight: float
) -> Tensor:
    """L_geo = L_photo + L_conf (equations 12 to 14) over the valid pixel set Omega = `mask`.

    Args:
        warped: [H, W, 3].
        target: [H, W, 3].
        confidence: C, [H, W], in (0, 1).
        mask: M_geo, bool [H, W].
        confidence_weight: lambda_c.

    Returns:
        Scalar; zero if no pixel is valid. |I_t - I_s| is the mean over the three channels.
    """
    count = mask.sum().clamp_min(1)
    residual = (target - warped).abs().mean(-1)
    # Floor: float32 sigmoids underflow to 0, whose logarithm is infinite.
    penalty = -torch.log(confidence.clamp_min(1e-7))
    return ((confidence * residual + confidence_weight * penalty) * mask).sum() / count


def source_candidates(views: Views, config: ConsistencyConfig) -> list[list[int]]:
    """For every view the views worth warping from: near, with a similar direction, but not in the same place.

    Returns:
        One list per view, the best first, at most `config.neighbours` long unless `config.pairs` is "random"; empty
        where no view qualifies.
    """
    centers = views.centers.double()
    axes = views.viewmats[:, 2, :3].double()
    distances = torch.cdist(centers, centers) / views.extent
    angles = torch.rad2deg(torch.arccos((axes @ axes.T).clamp(-1, 1)))
    fits = (angles < config.max_angle) & (distances > config.min_distance) & (distances < config.max_distance)
    order = (angles if config.pairs == "angle" else distances).argsort(dim=1)
    most = None if config.pairs == "random" else config.neighbours
    return [[j for j in row if fit[j]][:most] for row, fit in zip(order.tolist(), fits.tolist(), strict=True)]


class ConsistencyLoss:
    """L_geo as an extra loss of the fit: picks a source view, warps it, and trains the confidence network alongside."""

    def __init__(
        self, views: Views, images: Callable[[int], Tensor], config: ConsistencyConfig, *, iterations: int, seed: int,
        flags: Flags | None = None,
    ) -> None:  # fmt: skip
        """images: the picture [H, W, 3] of a view, in its state at the time of the call; not used for renderings.

        flags: On a GPU, of all that is trained together; somebody else reads them.
        """
        self.config, self.images, self.seed = config, images, seed
        self.flags = flags or Flags.on(views.viewmats.device)
        self.first = round(config.start * iterations)
        self.candidates = source_candidates(views, config)
        if not self.facts()["views_with_partner"]:
            warnings.warn(
                f"the geometric loss has no effect: none of the {len(views)} views has a partner whose optical axis "
                f"differs by less than {config.max_angle:g} degrees, {config.min_distance:g} to "
                f"{config.max_distance:g} scene extents away: raise consistency.max_angle, take more views, or set "
                "consistency to none",
                stacklevel=2,
            )
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = ConfidenceNet().to(views.viewmats.device)
        self.parameters = dict(self.network.named_parameters())  # a walk through the network costs as much as a layer
        self.optimizer = torch.optim.Adam(self.parameters.values(), lr=config.learning_rate)

    def facts(self) -> dict[str, int]:
        """For the record: of how many views the loss can be evaluated."""
        return {"views_with_partner": sum(map(bool, self.candidates)), "of": len(self.candidates)}

    def trained_along(self) -> list[Tensor]:
        """Parameters of the confidence network."""
        return list(self.parameters.values())

    def due(self, iteration: int) -> bool:
        """Whether this iteration evaluates the loss, and so needs depth."""
        return iteration >= self.first and iteration % self.config.every == 0

    def __call__(self, step: Step) -> Tensor | None:
        """Weighted L_geo of this iteration, or None where it is not due or the view has no partner."""
        candidates = self.candidates[step.view]
        if not self.due(step.iteration) or not candidates:
            return None
        # One stream per iteration: a resumed run picks the same partners.
        source = candidates[int(np.random.default_rng([self.seed, step.iteration]).integers(len(candidates)))]
        with torch.no_grad():
            render_s, depth_s, alpha_s, _ = step.rasterize_view(source)
        rendered, least = self.config.warped == "render", self.config.min_alpha
        target = step.render if rendered else self.images(step.view)
        warped, mask = reproject(
            render_s if rendered else self.images(source),
            torch.where(step.alpha > least, step.depth, 0.0),
            torch.where(alpha_s > least, depth_s, 0.0),
            Pinhole.of(step.views, step.view),
            Pinhole.of(step.views, source),
            self.config.occlusion_tolerance,
        )
        confidence = self.network(warped, target) if self.config.confidence else torch.ones_like(step.alpha)
        loss = consistency_loss(warped, target, confidence, mask, self.config.confidence_weight)
        return self.config.weight * self.config.every * loss

    def update(self) -> None:
        """Step the confidence network along the gradients that the last backward pass left in it.

        Raises:
            NotFinite: If they are not finite; they then stay there. On a GPU `flags` are told instead.
        """
        gradients = {name: p.grad for name, p in self.parameters.items() if p.grad is not None}
        if gradients:
            if self.flags is None:
                require_finite("confidence gradient of", gradients, "in L_geo", resumable=True)
                self.optimizer.step()
            else:
                self.flags.look({f"confidence gradient of {name}": g for name, g in gradients.items()}, "in L_geo")
                masked_step(self.optimizer, self.flags.bad)
            self.optimizer.zero_grad(set_to_none=True)

    def state(self) -> dict[str, Tensor]:
        """Weights and Adam moments of the confidence network."""
        return pack("confidence", self.network, self.optimizer)

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state`."""
        unpack("confidence", tensors, self.network, self.optimizer)
