"""Where cameras and first points come from. `SOURCES` names the sources; `align` compares them to the truth."""

from novags.cameras.source import CameraConfig, CameraSource
from novags.cameras.spelling import parse_settings, spell_settings
from sensor_model.files.registry import Registry

SOURCES: Registry[CameraSource] = Registry({
    "known": "novags.cameras.sources.known:SOURCE",
    "sfm": "novags.cameras.sources.sfm:SOURCE",
    "hloc": "novags.cameras.sources.hloc:SOURCE",
    "vggt": "novags.cameras.sources.vggt:SOURCE",
    "dust3r": "novags.cameras.sources.dust3r:SOURCE",
    "mast3r": "novags.cameras.sources.mast3r:SOURCE",
    "vggsfm": "novags.cameras.sources.vggsfm:SOURCE",
    "da3": "novags.cameras.sources.da3:SOURCE",
    "map-anything": "novags.cameras.sources.map_anything:SOURCE",
    "pi3": "novags.cameras.sources.pi3:SOURCE",
    "vggt-omega": "novags.cameras.sources.vggt_omega:SOURCE",
}, "novags.cameras", CameraSource)  # fmt: skip


def parse_cameras(text: str) -> CameraConfig:
    """`known`, `known:rotation_deg=1,translation=0.01`, `sfm:mapper=global`, `dust3r:checkpoint=FILE`, ...

    Raises:
        ValueError: If the source or a setting is unknown, given twice or missing, or a value does not fit.
    """
    config: CameraConfig = parse_settings(text, SOURCES, "cameras")
    return config


def spell_cameras(config: CameraConfig) -> str:
    """The shortest text that `parse_cameras` turns into this configuration."""
    return spell_settings(config, SOURCES)


def check_cameras(config: CameraConfig) -> None:
    """Raise a ValueError that says what to install or to give if this source cannot run here."""
    source_of(config).check(config)


def source_of(config: CameraConfig) -> CameraSource:
    """The row that a configuration belongs to."""
    return next(source for source in SOURCES.values() if source.config is type(config))
