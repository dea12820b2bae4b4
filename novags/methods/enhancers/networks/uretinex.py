"""URetinex-Net (Wu et al. 2022, "URetinex-Net: Retinex-Based Deep Unfolding Network for Low-Light Image Enhancement").

A network splits the picture I into reflectance R and illumination L. Three rounds alternate a step in closed form and
a network for each of both, all rounds with the same weights:

    P = (I Q + g R) / (Q² + g),   Q = (sum_c I_c P_c + l L) / (sum_c P_c² + l),   R <- net(P, Q),   L <- net(Q)

with g = 0.1 and l = 0.5, both 0.05 larger in each further round; in the first P and Q are R and L of the split. A last
network brightens L by a ratio, and the result is that times R. The authors' files are three; the last network's file
holds the others as well.

Code and files are for non-commercial use, so the code was not read. Names and sizes of the layers follow the official
files; the equations and constants are published. Everything else was chosen by the results of the official weights on
dark photographs. In all networks except R's the slopes leak by 0.2: only so R L is the picture (to 0.004 instead of
0.1) and L close to Q (0.017 instead of 0.09). In R's network they do not, and P is added to its result: only so it
removes noise. The last network takes L before the ratio: only so its result stays near 1.

It does not learn from a scene: it needs pairs.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from novags.methods.enhancers.networks.kind import Kind

ROUNDS = 3
FIRST_R, FIRST_L, MORE = 0.1, 0.5, 0.05  # weights of the first round, and the increment of each further one
LEAK = 0.2


def leaky(x: Tensor) -> Tensor:
    """The activation of all networks except R's."""
    return F.leaky_relu(x, LEAK)


class Decomposition(nn.Module):
    """I [B, 3, H, W] -> R [B, 3, H, W] and L [B, 1, H, W], at least 0."""

    def __init__(self) -> None:
        super().__init__()
        widths, layers = (3, 32, 32, 32, 4), list[nn.Module]()
        for inputs, outputs in zip(widths[:-1], widths[1:], strict=True):
            layers += [nn.Conv2d(inputs, outputs, 3, padding=1), nn.LeakyReLU(LEAK)]
        layers[-1] = nn.ReLU()
        self.decom = nn.Sequential(*layers)

    def forward(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """R and L."""
        both = self.decom(picture)
        return both[:, :3], both[:, 3:]


class Squeeze(nn.Module):
    """Each channel times a factor in 0..1 that follows from the means of all (Hu et al. 2018)."""

    def __init__(self, width: int, reduced: int) -> None:
        super().__init__()
        self.fc = nn.Sequential(
            nn.Linear(width, reduced, bias=False), nn.ReLU(), nn.Linear(reduced, width, bias=False), nn.Sigmoid()
        )

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, width, H, W]."""
        factors: Tensor = self.fc(x.mean((2, 3)))
        return x * factors[..., None, None]


class Reflectance(nn.Module):
    """P and Q -> R: P plus the output of eight convolutions."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 32, 3, padding=1)
        self.conv2 = nn.Conv2d(1, 32, 3, padding=1)
        self.se_layer = Squeeze(64, 4)
        for i in range(3, 9):
            self.add_module(f"conv{i}", nn.Conv2d(64, 64 if i < 8 else 3, 3, padding=1))

    def forward(self, p: Tensor, q: Tensor) -> Tensor:
        """R."""
        seen = self.se_layer(torch.cat([F.relu(self.conv1(p)), F.relu(self.conv2(q))], 1))
        for i in range(3, 8):
            seen = F.relu(self.get_submodule(f"conv{i}")(seen))
        return p + self.get_submodule("conv8")(seen)


class Layers(nn.Module):
    """Convolutions conv1, conv2, ... with leaky slopes between them, at least 0 at the end."""

    def __init__(self, widths: tuple[int, ...], sizes: tuple[int, ...]) -> None:
        super().__init__()
        self.count = len(sizes)
        for i, size in enumerate(sizes):
            self.add_module(f"conv{i + 1}", nn.Conv2d(widths[i], widths[i + 1], size, padding=size // 2))

    def forward(self, x: Tensor) -> Tensor:
        """x: [B, widths[0], H, W]."""
        for i in range(1, self.count):
            x = leaky(self.get_submodule(f"conv{i}")(x))
        return F.relu(self.get_submodule(f"conv{self.count}")(x))


class URetinex(nn.Module):
    """All four networks; names as in the official file of the last."""

    def __init__(self) -> None:
        super().__init__()
        self.model_decom = Decomposition()
        self.model_R = Reflectance()
        self.model_L = Layers((1, 32, 32, 32, 32, 1), (5, 5, 5, 5, 1))
        self.model_A = Layers((2, 32, 32, 32, 1), (5, 5, 5, 5))

    def unfolded(self, picture: Tensor) -> list[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """P, Q, R and L of every round, for I [B, 3, H, W] in 0..1."""
        R, L = self.model_decom(picture)
        Q, found = L, []
        for k in range(ROUNDS):
            g, weight = FIRST_R + MORE * k, FIRST_L + MORE * k
            P = R if k == 0 else (picture * Q + g * R) / (Q * Q + g)
            if k > 0:
                Q = ((picture * P).sum(1, keepdim=True) + weight * L) / ((P * P).sum(1, keepdim=True) + weight)
            R, L = self.model_R(P, Q), self.model_L(Q)
            found.append((P, Q, R, L))
        return found

    def forward(self, picture: Tensor, ratio: float) -> Tensor:
        """The enhanced picture, [B, 3, H, W], not clipped."""
        *_, R, L = self.unfolded(picture)[-1]
        return R * self.brightened(L, ratio)

    def brightened(self, L: Tensor, ratio: float) -> Tensor:
        """The illumination, brightened."""
        bright: Tensor = self.model_A(torch.cat([L, torch.full_like(L, ratio)], 1))
        return bright


def renamed(tensors: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    """The file of the decomposition calls its network model_R, like another one of the others."""
    return {name.replace("model_R.decom.", "model_decom.decom."): value for name, value in tensors.items()}


URETINEX = Kind(
    name="URetinex-Net", make=lambda config: URetinex(), renamed=renamed,
    run=lambda network, picture, config: network(picture, config.ratio),
    where="the authors' L_adjust.pth, which holds all, or a file of the same network, trained here",
)  # fmt: skip
enhance = URETINEX.enhance
