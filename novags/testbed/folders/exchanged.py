"""Whether the files of a set, a capture or a run are unchanged since they were written, wherever such a folder is
opened.
"""

from pathlib import Path

from novags.testbed.ledger.contents import read_json, refuse_damage

REMEDIES = {
    "set.json": "make it again, with --overwrite",
    "capture.json": "capture or import again, with --overwrite",
    "run.json": "make the run again, with --overwrite",
}
WRITTEN = {"stage": {"files?": {"*": str}}}  # by a stage of ours; other programs have files of these names too


def refuse_exchanged(folder: Path) -> None:
    """Refuse a set, a capture or a run, or a folder in one, whose files have changed since they were written.

    Folders from elsewhere have no record of their files, and are not compared.

    Raises:
        ValueError: Naming the files.
    """
    for name, remedy in REMEDIES.items():
        for place in (folder, folder.parent):
            try:
                record = read_json(place / name, WRITTEN)
            except ValueError:  # none there, or no record of ours; the reader of the folder refuses a damaged one
                continue
            inside = [file for file in record["stage"].get("files", {}) if file.startswith(f"{folder.name}/")]
            refuse_damage(place, record["stage"], remedy, None if place == folder else inside)
