"""How to reconstruct a capture."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from novags.cameras import spell_cameras
from novags.cameras.source import CameraConfig
from novags.cameras.sources.known import KnownConfig
from novags.methods import METHODS
from novags.methods.enhancers import ENHANCERS, enhancer_of
from novags.methods.variant import Variant, refuse_own_frames
from novags.numbers import POINTS, VIEWS, check_range
from novags.settings import check_seed, files_among, refuse_lost_files
from novags.testbed.ledger.code import Code, code_of, modules_of
from novags.testbed.ledger.contents import folder_digest
from novags.testbed.stages.seen import SEEN


@dataclass(frozen=True, kw_only=True)
class ReconstructConfig:
    """How to reconstruct a capture."""

    variant: Variant
    config: Any = None  # of the method; None for its defaults with the variant's settings
    cameras: CameraConfig = field(default_factory=KnownConfig)
    points: int = 8000  # Gaussians at the start, and at most if the fit's `cap_max` is None
    seed: int = 0
    hold_out: int = 0  # training views, drawn by the seed, that nothing is trained on: they judge lengths without truth
    given: str = ""  # an ingredient that is replaced by its truth: a name of `GIVEN`; "": none, as of every rival
    more: Path | None = None  # a capture whose views are trained on in place of the own; held-out views stay
    device: str = "auto"  # "auto", "cpu", "cuda": not part of a result's identity

    def __post_init__(self) -> None:
        if self.config is None:
            config = self.variant.config(METHODS[self.variant.method].config(), {})
            object.__setattr__(self, "config", config)
        method = METHODS[self.variant.method]
        refuse_own_frames(method, self.config, self.variant.fits)
        check_range("points", self.points, 4, POINTS)
        check_seed(self.seed)
        check_range("hold_out", self.hold_out, 0, VIEWS, " training views")
        if method.sees_surface and self.cameras != KnownConfig():
            raise ValueError(
                f"{self.variant.name} follows the true surface and so takes the set's own cameras, got cameras = "
                f"{spell_cameras(self.cameras)}: use known, or leave {self.variant.name} out"
            )

    @property
    def code(self) -> Code:
        """The code that reconstructs it: the stage, the method, the source of cameras and their configurations."""
        used = {*modules_of(self.config), *modules_of(self.cameras), SEEN.module_of(self.cameras.looks_at)}
        if hasattr(self.config, "enhance"):
            used.add(ENHANCERS.module_of(enhancer_of(self.config.enhance)[0]))
        return code_of("novags.testbed.stages.reconstructing", METHODS.module_of(self.variant.method), *used)

    def resolved(self) -> dict[str, Any]:
        """The settings that determine the result."""
        config = asdict(self.config)
        if not (fit := config.get("fit") or {}).get("keep_at", True):
            del fit["keep_at"]  # nothing is kept: the request of versions that could not
        return {
            "method": self.variant.method, "points": self.points, "seed": self.seed,
            "cameras": spell_cameras(self.cameras), "config": config,
            **({"fits": self.variant.fits} if self.variant.fits > 1 else {}),
            **({"hold_out": self.hold_out} if self.hold_out else {}),
            **({"given": self.given} if self.given else {}),
        }  # fmt: skip


def files_of(config: ReconstructConfig) -> dict[str, str]:
    """Content hash of every file that the settings of the method and of the cameras name, by setting and file.

    Raises:
        ValueError: If one of the method is not there. A source of cameras names missing parts and a remedy itself.
    """
    refuse_lost_files(config.config, "settings")
    named = files_among(config.config) | {f"cameras.{name}": p for name, p in files_among(config.cameras).items()}
    return {f"{setting}: {path.name}": folder_digest(path.parent, (), beside={path.name: path})
            for setting, paths in named.items() for path in paths if path.is_file()}  # fmt: skip
