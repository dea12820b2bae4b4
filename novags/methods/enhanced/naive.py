"""The published baseline as a row: enhance, then fit."""

from novags.methods.enhanced.by_enhancer import parts
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.variant import Method
from sensor_model.files.registry import Later

METHOD = Method(
    title="enhance, then fit the noisy pictures with the same loss (L1 and D-SSIM)",
    family="2D + GS",
    color="#c8590a",
    config=EnhancedFitConfig,
    train=Later("novags.methods.enhanced.enhance_then_fit:train"),
    parts=parts,
    source="section 4.2 of the NOVA-GS paper and 3DGS-MCMC (Kheradmand et al. 2024)",
    bound="floor",
)
