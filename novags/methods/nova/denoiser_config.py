"""Settings of the self-supervised denoiser: its network, its blind spots and their schedule."""

from dataclasses import dataclass, field
from typing import Literal

from novags.numbers import STEPS, check_range


@dataclass(frozen=True, kw_only=True)
class ResUNetConfig:
    """Size and arithmetic of the network. The defaults are the paper's."""

    widths: tuple[int, ...] = (32, 64, 128, 256)  # channels of the encoder levels
    bottleneck: int = 512  # channels
    # "plain": a U-Net of two convolutions a level, without residual blocks and their gates.
    blocks: Literal["attention-residual", "plain"] = "attention-residual"
    se_reduction: int = 16
    # Instance normalisation erases the absolute brightness of a view, which the decoder must then guess back.
    normalization: Literal["instance", "none"] = "instance"
    precision: Literal["float32", "bfloat16"] = "float32"  # of convolutions; weights stay float32

    def __post_init__(self) -> None:
        if not self.widths or min(*self.widths, self.bottleneck) < 1:
            raise ValueError(f"widths and bottleneck must be >= 1 channel, got {self.widths} and {self.bottleneck}")
        if self.se_reduction < 1:
            raise ValueError(f"se_reduction must be >= 1, got {self.se_reduction}")


@dataclass(frozen=True, kw_only=True)
class BlindSpotConfig:
    """How many pixels are blinded and how they are chosen."""

    mask_count: int | None = 60_000  # per whole view, the paper's number; None leaves only the fraction
    mask_fraction: float = 0.32  # at most this share of a view; 60,000 px are this much of the paper's smallest (LOM)
    laplacian_share: float = 0.5  # of the mask, drawn by high-frequency content; the rest is uniform
    window: int = 5  # px, edge of the neighbourhood that replacements come from
    # Blind one colour channel of a pixel instead of all three: the other two show its texture. This needs channels with
    # independent noise: a three-chip camera, without JPEG or a colour matrix. None: wherever that holds. The paper
    # blinds all three.
    per_channel: bool | None = False
    # Blind the sensor's samples, packed as four channels of half the size, instead of demosaiced pictures, whose noise
    # neighbours share; the result is demosaiced. This needs a known colour filter array, and neither JPEG nor a colour
    # matrix. None: wherever that holds. Sizes of windows, crops and blurs are then in cells of 2 px.
    packed: bool | None = False

    def __post_init__(self) -> None:
        if self.mask_count is not None and self.mask_count < 1:
            raise ValueError(f"mask_count must be >= 1 or None, got {self.mask_count}")
        if not 0 < self.mask_fraction < 1:
            raise ValueError(f"mask_fraction must lie in (0, 1), got {self.mask_fraction}")
        if not 0 <= self.laplacian_share <= 1:
            raise ValueError(f"laplacian_share must lie in [0, 1], got {self.laplacian_share}")
        if self.window < 3 or self.window % 2 == 0:
            raise ValueError(f"window must be odd and >= 3 px, got {self.window}")

    def fraction(self, view_pixels: int) -> float:
        """Share of pixels to blind, for views of `view_pixels` pixels; the same share holds for crops of them."""
        limit = 1.0 if self.mask_count is None else self.mask_count / view_pixels
        return min(self.mask_fraction, limit)


@dataclass(frozen=True, kw_only=True)
class DenoiserConfig:
    """Network, masks and schedule of the denoiser."""

    network: ResUNetConfig = field(default_factory=ResUNetConfig)
    blind_spots: BlindSpotConfig = field(default_factory=BlindSpotConfig)
    warmup_steps: int = 500  # before the first splat iteration
    denoise_every: int | None = 1  # splat iterations between two further steps; None trains in the warm-up only
    batch: int = 1  # crops per step
    crop: int | None = None  # px; None takes whole views
    learning_rate: float = 1e-3  # Adam
    decay: Literal["constant", "cosine"] = "constant"  # of the learning rate over all steps
    augment: bool = False  # random flips and quarter turns of a batch
    # The network predicts the difference to a Gaussian blur (sigma in px) of its blinded input whose kernel leaves out
    # the centre: training then starts at the quality of a blur. None predicts the image itself, as the paper does.
    residual_blur: float | None = None
    # Share of the noisy image in I_clean. A blind-spot network infers a pixel from its neighbours, so its error and the
    # pixel's own noise are independent, and a mix of the two beats both; fine texture, which neighbours do not predict,
    # comes back. The paper has 0.
    noisy_share: float = 0.0

    def __post_init__(self) -> None:
        check_range("warmup_steps", self.warmup_steps, 0, STEPS)
        if self.denoise_every is not None and self.denoise_every < 1:
            raise ValueError(f"denoise_every must be >= 1 or None, got {self.denoise_every}")
        if self.batch < 1 or (self.crop is not None and self.crop < 2):
            raise ValueError(f"need batch >= 1 and crop >= 2 px, got {self.batch} and {self.crop}")
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate must be > 0, got {self.learning_rate}")
        if self.residual_blur is not None and not self.residual_blur > 0:
            raise ValueError(f"residual_blur must be > 0 px or None, got {self.residual_blur}")
        if not 0 <= self.noisy_share < 1:
            raise ValueError(f"noisy_share must lie in [0, 1), got {self.noisy_share}")

    def total_steps(self, iterations: int) -> int:
        """Optimiser steps in a run of so many splat iterations."""
        concurrent = 0 if self.denoise_every is None else -(-iterations // self.denoise_every)
        return self.warmup_steps + concurrent


# Settings that a CPU can afford. No instance normalisation, because it erases brightness; no targeted blind spots,
# because they favour pixels for their own noise. Starting from a blur saves the steps of learning one. Where the
# channels of a pixel have independent noise, blinding one at a time leaves the others to inform it. A blind spot knows
# less about a pixel than the pixel itself does, so part of the noisy picture is mixed in. Many steps on small crops
# learn more in the same time than few steps on whole views.
FAST_DENOISER = DenoiserConfig(
    network=ResUNetConfig(widths=(16, 32, 64), bottleneck=96, normalization="none"),
    blind_spots=BlindSpotConfig(mask_fraction=0.2, laplacian_share=0.0, per_channel=None),
    denoise_every=None,
    batch=4,
    crop=48,
    learning_rate=1.5e-3,
    decay="cosine",
    augment=True,
    residual_blur=0.8,
    noisy_share=0.35,
)
