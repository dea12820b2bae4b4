"""Every reader of files that people bring, by name. A new reader gets a row here."""

from tests.fuzz.case import Reader
from tests.fuzz.readers import commands, foreign, images, imported, models, photographs, records, scenes, studies, text

READERS: dict[str, Reader] = {
    reader.name: reader
    for group in (commands, foreign, text, models, images, imported, photographs, records, scenes, studies)
    for reader in group.READERS
}
