"""List the licence of every package that novags installs, with what these need themselves.

    python scripts/files/licences.py [EXTRA ...]

Read from the packages that are installed here. Exit code 1 if one of them names no licence, or one of the GPL or AGPL
alone, which novags could not be given away with.
"""

import re
import sys
from importlib import metadata

from packaging.requirements import Requirement

SIGNS = {
    "GNU GENERAL PUBLIC LICENSE": "GPL", "GNU AFFERO": "AGPL", "Apache License": "Apache",
    "Permission is hereby granted, free of charge": "MIT", "Redistribution and use in source and binary": "BSD",
}  # fmt: skip


def needed(name: str, extras: set[str], found: dict[str, metadata.Distribution]) -> dict[str, metadata.Distribution]:
    """The installed packages that a package needs, by name, itself among them."""
    key = re.sub(r"[-_.]+", "-", name).lower()
    try:
        package = found.setdefault(key, metadata.distribution(name))
    except metadata.PackageNotFoundError:
        return found  # of another platform, or an extra that is not installed
    for line in package.requires or ():
        requirement = Requirement(line)
        known = re.sub(r"[-_.]+", "-", requirement.name).lower() in found
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            if not known or requirement.extras:
                needed(requirement.name, requirement.extras, found)
    return found


def licence(package: metadata.Distribution) -> str:
    """As a package names it: an expression, a word, classifiers, or the text that it brings; "" if there is none."""
    about = package.metadata
    listed = [line.rpartition(" :: ")[2] for line in about.get_all("Classifier", []) if line.startswith("License ::")]
    named = [text for key in ("License-Expression", "License") for text in about.get_all(key, []) if len(text) < 200]
    if named or listed:
        return named[0] if named else ", ".join(listed)
    return by_text(" ".join(file.read_text() for file in package.files or () if "LICENSE" in file.name))


def by_text(text: str) -> str:
    """Which licence a text is."""
    words = " ".join(text.split())
    return next((f"{name}, by its text" for sign, name in SIGNS.items() if sign in words), "")


def free(name: str) -> bool:
    """Whether novags can be given away together with a package under this licence."""
    choices = re.split(r"\bOR\b", name)
    return bool(name) and not all(re.search(r"\bA?GPL|(?<!Lesser )General Public License", one) for one in choices)


def main() -> None:
    """Print the list."""
    found = needed("novags", set(sys.argv[1:]), {})
    names = {f"{key} {package.version}": licence(package) for key, package in sorted(found.items())}
    for package, name in names.items():
        print(f"{package:<36} {name or 'NO LICENCE NAMED'}")
    if wrong := [package for package, name in names.items() if not free(name)]:
        raise SystemExit(f"look at these: {', '.join(wrong)}")


if __name__ == "__main__":
    main()
