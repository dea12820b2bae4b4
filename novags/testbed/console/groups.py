"""The control groups of this process, whose limits may be below the machine's: of a container, a service, a job."""

from pathlib import Path, PurePosixPath

ROOT = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")


def levels(controller: str) -> list[Path]:
    """Folders of this process's group and of the groups above it, of versions 1 and 2; the lowest of their limits
    holds.

    In a container without a namespace of its own for groups, MEMBERSHIP names folders that are not there to see: its
    limits are in the root, which is always among these.

    Args:
        controller: "memory", "cpu".
    """
    found = [ROOT, ROOT / controller]
    try:
        lines = MEMBERSHIP.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not Linux
        return found
    for line in lines:
        _, controllers, path = line.split(":", 2)  # version 2 names no controllers
        if not controllers or controller in controllers.split(","):
            inside = PurePosixPath(path.lstrip("/"))
            found += [found[bool(controllers)] / part for part in (inside, *inside.parents)]
    return list(dict.fromkeys(found))
