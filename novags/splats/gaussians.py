"""The scene: N anisotropic 3D Gaussians as plain tensors. Each trained tensor carries its space in its name."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from .sh import n_coefficients, rgb_to_sh


@dataclass
class Gaussians:
    """Parameters of N Gaussians, float32 leaves.

    Attributes:
        means: Positions [N, 3], world units.
        quats: Rotations wxyz [N, 4], any non-zero length.
        log_scales: Natural logs of the standard deviations along the principal axes [N, 3].
        logit_opacities: Logits of the opacities [N].
        sh: Spherical-harmonics coefficients [N, K, 3], K = (degree + 1)^2.
        features: Further numbers that a method trains for each of them [N, F]; None: nothing. They go wherever their
            Gaussian goes; only the method's own losses know their meaning.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logit_opacities: Tensor
    sh: Tensor
    features: Tensor | None = None

    def __post_init__(self) -> None:
        n = len(self.means)
        want = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "logit_opacities": (n,)}
        for name, shape in want.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {list(shape)}, got {list(getattr(self, name).shape)}")
        if self.sh.shape not in [(n, n_coefficients(degree), 3) for degree in range(4)]:
            raise ValueError(f"sh must be [N={n}, 1, 4, 9 or 16, 3], got {list(self.sh.shape)}")
        if self.features is not None and (self.features.ndim != 2 or len(self.features) != n):
            raise ValueError(f"features must be [N={n}, F] or None, got {list(self.features.shape)}")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Highest spherical-harmonics degree stored."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    @property
    def scales(self) -> Tensor:
        """Standard deviations [N, 3], world units."""
        return torch.exp(self.log_scales)

    @property
    def opacities(self) -> Tensor:
        """Opacities [N], 0..1."""
        return torch.sigmoid(self.logit_opacities)

    def tensors(self) -> dict[str, Tensor]:
        """The parameter tensors by name: five, and the features where there are any."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: tensor for name, tensor in named.items() if tensor is not None}

    def requires_grad_(self, requires_grad: bool = True) -> "Gaussians":
        """Switch gradients of all tensors; returns self."""
        for tensor in self.tensors().values():
            tensor.requires_grad_(requires_grad)
        return self

    def to(self, device: torch.device | str) -> "Gaussians":
        """The same Gaussians on a device."""
        return Gaussians(**{name: tensor.to(device) for name, tensor in self.tensors().items()})

    def detach(self) -> "Gaussians":
        """The same Gaussians outside autograd; memory is shared."""
        return Gaussians(**{name: tensor.detach() for name, tensor in self.tensors().items()})

    @staticmethod
    def from_points(
        points: Tensor,
        colors: Tensor,
        *,
        sh_degree: int,
        init_opacity: float = 0.5,
        init_scale: float = 0.7,
        n_neighbors: int = 3,
    ) -> "Gaussians":
        """Isotropic Gaussians at points, as wide as the points are apart.

        Args:
            points: [P, 3], world units.
            colors: [P, 3], 0..1.
            sh_degree: 0..3; higher coefficients start at zero.
            init_opacity: 0 < o < 1.
            init_scale: Standard deviation in units of the root mean squared distance to the nearest neighbours.
                3DGS-MCMC uses 0.1; dense points (from depth maps) need about 0.7 to close the surface.
            n_neighbors: How many neighbours that mean takes.

        Returns:
            P Gaussians with identity rotations.

        Raises:
            ValueError: For fewer than two points, wrong shapes, non-finite values or values out of range.
        """
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or colors.shape != points.shape:
            raise ValueError(
                f"points and colors must both be [P >= 2, 3], got {list(points.shape)} and {list(colors.shape)}"
            )
        for name, value in (("points", points), ("colors", colors)):
            bad = int((~torch.isfinite(value)).sum())
            if bad:
                raise ValueError(f"{name} must be finite, got {bad} non-finite of {value.numel()} values")
        if not 0 < init_opacity < 1 or not init_scale > 0:
            raise ValueError(
                f"init_opacity must lie in (0, 1) and init_scale must be > 0, got {init_opacity} and {init_scale}"
            )
        n_neighbors = min(n_neighbors, len(points) - 1)
        place = points.detach().cpu().double().numpy()
        distances, _ = cKDTree(place).query(place, k=n_neighbors + 1)
        squared = torch.from_numpy(distances[:, 1:] ** 2).mean(1).to(points.device)
        # Coinciding points would start with scale 0, whose log is -inf. The floor shrinks with a small scene, where all
        # points are close; 1e-30 is for a scene whose points all coincide.
        spread = float(np.square(place - place.mean(0)).sum(1).mean())
        scale = init_scale * torch.sqrt(squared.clamp_min(max(1e-7 * min(1.0, spread), 1e-30)))
        sh = torch.zeros(len(points), n_coefficients(sh_degree), 3, device=points.device)
        sh[:, 0] = rgb_to_sh(colors.float())
        quats = torch.zeros(len(points), 4, device=points.device)
        quats[:, 0] = 1
        return Gaussians(
            means=points.float().clone(memory_format=torch.contiguous_format),
            quats=quats,
            log_scales=torch.log(scale).float()[:, None].repeat(1, 3),
            logit_opacities=torch.full_like(quats[:, 0], float(torch.logit(torch.tensor(init_opacity)))),
            sh=sh,
        )
