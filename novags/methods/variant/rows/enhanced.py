"""Variants of the methods that enhance, then fit: of the enhancement, or of the fit to it."""

from novags.methods.variant import Variant

NAIVE_L1 = Variant(
    name="naive-l1",
    method="naive",
    title="enhance, then fit the noisy pictures with L1 alone, which averages noise over the views",
    settings={"fit.dssim_weight": 0.0},
)

GAMMA_AUTO = Variant(
    name="gamma-auto-gs",
    method="gamma-gs",
    title="raise every code to the power that brings the mean of the picture to 0.5, then fit as naive does",
    settings={"enhance.gamma": None},
)

SCI_PLUS = Variant(
    name="sci-plus-gs",
    method="sci-gs",
    title="SCI with this project's reading of the additivity condition of SCI++ (Ma et al. 2025), then fit as naive "
    "does",
    settings={"enhance.additivity": 1.0},
)

ORACLE_DEMOSAICED = Variant(
    name="oracle-demosaiced",
    method="oracle",
    title="the same from noise-free mosaics, interpolated as the pictures are: what demosaicing costs by itself",
    settings={"demosaiced": True},
)

ASE_SCENE = Variant(
    name="ase-scene-gs",
    method="ase-gs",
    title="raise all pictures by one adaptive exponential, of the mean statistics of the scene, then fit as naive does",
    settings={"enhance.scene_wide": True},
)

AP3_SCENE = Variant(
    name="ap3-scene-gs",
    method="ap3-gs",
    title="raise all pictures by one adaptive cubic, of the mean statistics of the scene, then fit as naive does",
    settings={"enhance.scene_wide": True},
)
