"""Every reader of files that people bring, by name. A new reader gets a row here."""

from tests.fuzz.case import Reader
from tests.fuzz.readers import (
    commands,
    curves,
    foreign,
    gltf,
    images,
    imported,
    models,
    photographs,
    records,
    scenes,
    studies,
    text,
)

GROUPS = (commands, curves, foreign, text, models, images, imported, photographs, records, scenes, gltf, studies)
READERS: dict[str, Reader] = {reader.name: reader for group in GROUPS for reader in group.READERS}
