"""Variants of methods that have a single one."""

from novags.methods.variant import Variant

I2_NERF_TRUTH = Variant(
    name="i2-nerf-truth",
    method="i2-nerf",
    title="I2-NeRF as published: the brightness that it aims at comes from well-lit pictures of the scene",
    settings={"truth_statistics": True},
)

DENOISE_PLAIN = Variant(
    name="denoise-gs-plain",
    method="denoise-gs",
    title="the same network without being adapted to the capture",
    settings={"denoise.adapt": None},
)

AVERAGING_CLEAN = Variant(
    name="averaging-clean",
    method="averaging",
    title="the same average of the noise-free exposures: what bringing them to the view costs by itself",
    settings={"exposures": "noise-free"},
)
