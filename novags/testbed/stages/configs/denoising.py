"""How the pictures of a capture are denoised."""

from dataclasses import dataclass, field

from novags.methods.denoised.config import DenoiseConfig
from novags.settings import check_seed
from novags.testbed.folders.set import for_photographs
from novags.testbed.ledger.code import Code, code_of, modules_of


@dataclass(frozen=True, kw_only=True)
class DenoisePicturesConfig:
    """How the pictures of a capture are denoised."""

    denoise: DenoiseConfig = field(default_factory=DenoiseConfig)
    seed: int = 0
    device: str = "auto"  # "auto", "cpu", "cuda": not part of a result's identity

    def __post_init__(self) -> None:
        check_seed(self.seed)

    @property
    def code(self) -> Code:
        """What denoises them."""
        return code_of("novags.testbed.stages.denoising", *modules_of(self.denoise), *for_photographs())
