"""Presets: whole experiments by name, from a demonstration to the paper's own settings."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from novags.methods.nova.blindspot import BlindSpotConfig
from novags.methods.nova.consistency import ConsistencyConfig
from novags.methods.nova.denoiser import DenoiserConfig
from novags.methods.nova.resunet import ResUNetConfig
from novags.methods.nova.trainer import NovaConfig
from novags.methods.table import METHODS
from novags.splats import FitConfig, McmcConfig
from novags.testbed.stages.capture import CaptureConfig
from novags.testbed.stages.reconstruct import ReconstructConfig
from novags.testbed.stages.render import RenderConfig

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Config = TypeVar("Config", bound="DataclassInstance")


@dataclass(frozen=True, kw_only=True)
class Preset:
    """An experiment: what to render, how to photograph it, which methods with which settings."""

    render: RenderConfig
    capture: CaptureConfig
    methods: tuple[str, ...] = ("nova", "naive", "oracle")
    points: int  # Gaussians at the start
    nova: NovaConfig  # settings of every method

    def __post_init__(self) -> None:
        if unknown := [name for name in self.methods if name not in METHODS]:
            raise ValueError(f"unknown method(s) {', '.join(unknown)}; there are {', '.join(METHODS)}")
        if not self.methods or len(set(self.methods)) < len(self.methods):
            raise ValueError(f"methods must be named once each, got {', '.join(self.methods) or 'none'}")
        for method in self.methods:  # it checks the rest
            self.reconstruct(method)

    def reconstruct(self, method: str) -> ReconstructConfig:
        """How the experiment reconstructs by one of its methods."""
        return ReconstructConfig(method=method, points=self.points, seed=self.capture.seed, nova=self.nova)


# What a CPU can afford. No instance normalisation, because it erases brightness; no targeted blind spots, because they
# favour pixels for their own noise. Starting at a blur saves the steps of learning one. Where its channels are
# independent, blinding one at a time leaves the others to tell about it. A blind spot knows less of a pixel than the
# pixel does, so some of it is mixed in. Many steps on small batches learn more in the same time than few on large ones.
FAST_DENOISER = DenoiserConfig(
    network=ResUNetConfig(widths=(16, 32, 64), bottleneck=96, normalization="none"),
    blind_spots=BlindSpotConfig(mask_fraction=0.2, laplacian_share=0.0, per_channel=True),
    warmup_steps=400,
    denoise_every=None,
    batch=4,
    crop=48,
    learning_rate=1.5e-3,
    decay="cosine",
    augment=True,
    residual_blur=0.8,
    noisy_share=0.35,
)

PRESETS = {
    "demo": Preset(
        render=RenderConfig(scene="tabletop", n_views=20, width=160, height=160, spp=96),
        capture=CaptureConfig(sensor="a7s2-iso6400-3chip", electrons=20.0),
        points=20_000,
        nova=NovaConfig(
            denoiser=FAST_DENOISER,
            consistency=ConsistencyConfig(every=16),
            fit=FitConfig(
                iterations=2400, sh_degree=1, sh_every=400, mcmc=McmcConfig(refine_start=100), checkpoint_every=250
            ),
        ),
    ),
    "small": Preset(
        render=RenderConfig(scene="tabletop", n_views=64, width=256, height=256, spp=256),
        capture=CaptureConfig(sensor="a7s2-iso6400-3chip", electrons=20.0),
        methods=("nova", "naive", "naive-l1", "oracle"),
        points=30_000,
        nova=NovaConfig(
            denoiser=FAST_DENOISER,
            consistency=ConsistencyConfig(every=4),
            fit=FitConfig(iterations=3000, sh_degree=2, sh_every=500, checkpoint_every=250),
        ),
    ),
    # The paper's settings where it states them, the defaults of 3DGS-MCMC where it does not.
    "paper": Preset(
        render=RenderConfig(scene="tabletop", n_views=128, width=800, height=800, spp=1024),
        capture=CaptureConfig(sensor="a7s2-iso6400", electrons=20.0),
        methods=("nova", "naive", "naive-l1", "oracle"),
        points=100_000,
        nova=NovaConfig(fit=FitConfig(iterations=7000, cap_max=1_000_000, checkpoint_every=250)),
    ),
}


def adapted(
    preset: Preset,
    *,
    scene: str | None = None,
    sensor: str | None = None,
    electrons: float | None = None,
    methods: tuple[str, ...] | None = None,
    n_views: int | None = None,
    width: int | None = None,
    height: int | None = None,
    spp: int | None = None,
    points: int | None = None,
    iterations: int | None = None,
    denoiser_steps: int | None = None,
    seed: int | None = None,
) -> Preset:
    """The preset with some settings changed; None keeps its own.

    Raises:
        ValueError: If a value is out of range.
    """
    nova = preset.nova
    return _changed(
        preset,
        render=_changed(preset.render, scene=scene, n_views=n_views, width=width, height=height, spp=spp, seed=seed),
        capture=_changed(preset.capture, sensor=sensor, electrons=electrons, seed=seed),
        methods=methods,
        points=points,
        nova=_changed(
            nova,
            fit=_changed(nova.fit, iterations=iterations),
            denoiser=_changed(nova.denoiser, warmup_steps=denoiser_steps),
        ),
    )


def _changed(config: Config, **values: Any) -> Config:
    return replace(config, **{name: value for name, value in values.items() if value is not None})
