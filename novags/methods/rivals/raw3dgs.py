"""Raw3DGS (Li et al. 2024, "From Chaos to Clarity: 3DGS in the Dark"): Gaussians and an extractor of noise.

A datum is x + n, its noise n normal with the variance s^2(x) of the camera. A network F extracts the noise n' of a view
from its data y. Both are trained together. With the render r and z = n' / s(r),

    loss = mean of ((min(r, white) - (y - n')) / (sg(r) + epsilon))^2  +  a mean of z^2 / 2  +  b |I - C|^2 / d

where sg holds its argument fixed, s(r) is held fixed too, and C is the mean of v v^T over the patches v of z, of d data
each. The second term is the negative log likelihood of n' but for a constant. It alone would make n' vanish, and the
third keeps its covariance at white noise of the known variance: both together are least at a variance of 1 - a / (4 b).

Published: the terms, a = 5 or 3, b = 20, rates, and the loss of the render, which is RawNeRF's. Chosen by us, because
it is not public:

- F is the network of `denoised`, the difference of its input and its output: a U-Net of packed pixels in units of the
  noise. Where the publication pretrains on pairs of SID, it was trained on simulated cameras, and is then adapted to
  the capture on pairs that the known noise makes (`recorrupted`). It never sees a noise-free exposure of the capture.
- The norm of the third term is Frobenius' squared, for each datum of a patch. Were it the mean over all d^2 entries,
  the second term would win, and most of n' vanish. Patches begin at every second pixel: a mosaic's under one filter.
- s(r) is fixed as the denominator of the loss is. Its slope would darken the render as far as n' lacks variance.

Left out: the distortion of the render by the lens, for all captures here are undistorted; a pattern of offsets pixel by
pixel, for no noise record has one: the dark signal that it states is subtracted, and offsets count as noise;
Scaffold-GS's anchors, for which 3DGS-MCMC stands in, as for all methods.
"""

import dataclasses
import time
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.denoised.estimate import estimate
from novags.methods.denoised.measured import MeasuredPictures, in_electrons
from novags.methods.denoised.network import Network
from novags.methods.denoised.recorrupted import LEAST_VARIANCE, adapt
from novags.methods.denoised.weights import load_weights
from novags.methods.enhanced.gaussian_fit import fit_for, reconstructed
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.applying import enhanced, enhanced_light
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.light import brightness, first_light, problem_light, raw_loss
from novags.methods.noise_estimate import noise_of
from novags.methods.problem import Problem, gathered, refuse_uneven
from novags.methods.reconstruction import Progress, Reconstruction, counted_on
from novags.methods.rivals.rows.raw3dgs import Raw3dgsConfig, parts
from novags.splats.gaussians import Gaussians
from novags.splats.training.companion import Companion
from novags.splats.training.fit import fit
from novags.splats.training.step import Step
from novags.splats.views import Views

COOL_FROM, COOL_TO = 5 / 6, 0.1  # of the run, and of the network's rate: 1e-5 after 25,000 of 30,000 steps
EVERY = 2  # px between patches


def likelihood(whitened: Tensor, mask: Tensor) -> Tensor:
    """Mean of z^2 / 2 over the data: -log of their normal density, but for a constant.

    Args:
        whitened: z, [3, H, W], 0 where nothing was measured.
        mask: The same shape, 1 where something was.
    """
    return whitened.square().sum() / (2 * mask.sum())


def decorrelation(planes: Tensor, patch: int) -> Tensor:
    """Squared distance of the covariance of patches from the identity, for each of their data.

    Args:
        planes: z, [P, H, W]: of three chips each channel, of a mosaic one plane of what it measured.
        patch: Side of a patch, px; of smaller pictures, their shorter side.
    """
    side = min(patch, *planes.shape[1:])
    patches = F.unfold(planes[None], side, stride=EVERY)[0]
    covariance = patches @ patches.T / patches.shape[1]
    white = torch.eye(len(patches), device=planes.device, dtype=planes.dtype)
    return (white - covariance).square().sum() / len(patches)


class ExtractorLoss:
    """The loss of a Step whose render is light, and whose target are the data of its view, electrons [3, H, W].

    A `PictureLoss`.

    Attributes:
        network: F; learns beside the Gaussians.
        pictures: The measurements.
        scale: [3], light of the render per electron.
        white: Where each channel saturates, [3], light of the render.
        epsilon: In the same unit.
        weights: a and b.
        patch: As for `decorrelation`.
    """

    def __init__(
        self, network: Network, pictures: MeasuredPictures, config: Raw3dgsConfig, *, unit: float, white: Tensor
    ) -> None:
        self.network, self.pictures = network, pictures
        self.scale, self.white, self.epsilon = pictures.unit / unit, white / unit, config.epsilon / unit
        self.weights = config.noise_weight_of(len(pictures.electrons)), config.covariance_weight
        self.patch, self.mosaic = config.patch, not bool(pictures.mask.all())

    def trained_along(self) -> list[Tensor]:
        """Parameters of the network."""
        return list(self.network.parameters())

    def split(self, electrons: Tensor, render: Tensor) -> tuple[Tensor, Tensor]:
        """Data of a view [3, H, W] without the noise that the network finds, electrons, and that noise as z.

        Where nothing was measured, the first is the network's interpolation, and z is 0. `render`: [H, W, 3].
        """
        pictures = self.pictures
        clean = estimate(self.network, electrons[None], pictures.mask, pictures.read_variance)[0]
        variance = pictures.variance((render.detach() / self.scale).movedim(-1, 0))
        # Floor: as for the adaptation of a network, 0 / 0 in black of a camera that reads without noise.
        return clean, (electrons - clean) * pictures.mask[0] / variance.clamp_min(LEAST_VARIANCE).sqrt()

    def __call__(self, step: Step, *target: Tensor) -> Tensor:
        """The loss."""
        clean, whitened = self.split(target[0], step.render)
        mask, (likely, white) = self.pictures.mask[0], self.weights
        light = torch.where(mask > 0, clean, torch.nan).movedim(0, -1) * self.scale
        planes = whitened.sum(0, keepdim=True) if self.mosaic else whitened
        return (
            raw_loss(step.render, light, self.epsilon, self.white)
            + likely * likelihood(whitened, mask)
            + white * decorrelation(planes, self.patch)
        )


def train(
    problem: Problem, config: Raw3dgsConfig, *, progress: Progress | None = None, checkpoint: Path | None = None
) -> Reconstruction:
    """Reconstruct the light of a scene from its raw frames, or from linear 16-bit pictures; see `Method.train`.

    Returns:
        A reconstruction in linear light, in the unit of the linear 16-bit pictures. Its targets are the data without
        the extracted noise, enhanced; `found` has the mean square of z at the end. Seconds: "fit" and "other".

    Raises:
        LacksInput: If the problem has neither raw frames nor 16-bit linear pictures, their noise is not independent, or
            views differ in exposure.
        ValueError: If the pictures hold no light; and as `Method.train` says.
    """
    started = time.perf_counter()
    config = dataclasses.replace(config, fit=fit_for(problem, config.fit))
    refuse_uneven(problem.exposures, "a noise extractor")
    noise = noise_of(problem)
    data = problem_light(problem, noise, problem.channels_share + problem.pixels_share)
    pictures, unit = in_electrons(data), brightness(data.light)
    colors = (first_light(problem.start, data) / unit).clamp(0, 1).to(data.light)
    white = data.white
    matrix = torch.eye(3) if data.matrix is None else data.matrix.cpu()
    del data  # as many bytes as the pictures
    network = pretrained(problem, config, pictures, progress, checkpoint)
    loss = ExtractorLoss(network, pictures, config, unit=unit, white=white)
    companion = Companion(network=network, optimizer=torch.optim.Adam(network.parameters(), lr=config.extractor_rate))
    last = COOL_FROM * config.fit.iterations

    def cool(iteration: int) -> None:
        companion.rates = [config.extractor_rate * (1.0 if iteration < last else COOL_TO)]

    start = Gaussians.from_points(
        problem.start.points.to(colors), colors, sh_degree=config.fit.sh_degree, init_scale=config.init_scale
    )
    result = fit(
        start, problem.views, pictures.electrons.__getitem__, config.fit, photometric=loss, companion=companion,
        before_step=cool, checkpoint=checkpoint, progress=counted_on(progress, parts(config)["pretraining"]),
    )  # fmt: skip
    shown = GaussianScene.of(result.gaussians, config.fit)
    left, squares = _left(loss, shown, dataclasses.replace(problem.views, viewmats=result.viewmats))
    scene = dataclasses.replace(shown, matrix=unit * matrix)
    return reconstructed(
        result, config, scene, "linear", started, along=scene.along(result.kept),
        found={"unit": unit, "noise_weight": loss.weights[0], "noise": noise.origin, "noise_variance": squares},
        enhancement=enhancement_record(config.enhance, config.pictures),
        enhanced=enhanced(problem, config.enhance, config.pictures),
        targets=gathered(enhanced_light(problem, left, config.enhance, config.pictures), left),
    )  # fmt: skip


def pretrained(
    problem: Problem, config: Raw3dgsConfig, pictures: MeasuredPictures, progress: Progress | None,
    checkpoint: Path | None,
) -> Network:  # fmt: skip
    """The network at the start of the fit; where a checkpoint is, as shipped, because the fit takes it from there."""
    network = load_weights().to(pictures.electrons.device)
    if config.pretrain is None or (checkpoint is not None and checkpoint.exists()):
        return network
    more = config.fit.iterations
    return adapt(network, pictures, config.pretrain, seed=problem.seed, progress=progress, more=more).after


@torch.no_grad()
def _left(loss: ExtractorLoss, scene: GaussianScene, views: Views) -> tuple[Tensor, float]:
    """The data without their noise as light of linear pictures [C, H, W, 3], and the mean square of z."""
    pictures, total = loss.pictures, 0.0
    light = torch.empty_like(pictures.electrons.movedim(1, -1))
    for place, electrons, view in zip(light, pictures.electrons, views.each(), strict=True):
        clean, whitened = loss.split(electrons, scene.render(view)[0][0])
        total += 2 * float(likelihood(whitened, pictures.mask[0]))
        place.copy_(pictures.linear(clean[None])[0])
    return light, total / len(light)
