"""Parts that Mitsuba's plugins need but do not check themselves: without them they crash, or fail far from the cause.

Plugins that fail with any input are refused too.

Every plugin was tried bare, in each place where one may stand; plugins that refuse it with a reason of their own
are not listed here.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True)
class Need:
    """What a plugin needs: one of some named parameters, or so many children of some kinds."""

    named: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    count: int = 1

    def met(self, names: Collection[str], kinds: list[str]) -> bool:
        """Whether parameters of these names and children of these kinds are enough; a <ref> may be of any kind."""
        if self.named:
            return any(name in names for name in self.named)
        return sum(kind in (*self.kinds, "ref") for kind in kinds) >= self.count

    def __str__(self) -> str:
        if self.named:
            return f"a parameter {' or '.join(map(repr, self.named))}"
        return f"{'a child' if self.count == 1 else f'{self.count} children'} of kind {' or '.join(self.kinds)}"


NEEDS: dict[str, Need] = {
    "bitmap": Need(named=("filename", "bitmap", "data")),
    "blendbsdf": Need(kinds=("bsdf",), count=2),
    "merge": Need(kinds=("shape",)),
    "volume": Need(kinds=("volume",)),
}
# Mitsuba 3.9: llvm and cuda stop in the middle of a render, and of later renders of other scenes in the same process;
# scalar renders 4,700 times the light that a 'sunsky' of the same turbidity sends.
BROKEN = {
    "timed_sunsky": "Mitsuba's llvm and cuda variants cannot render it, and the scalar one makes it too bright; use "
    "'sunsky' with a sun_direction",
}


def check_complete(plugin: str, names: Collection[str], kinds: list[str], where: str) -> None:
    """Refuse a plugin that lacks a part it needs, or fails with any input.

    Args:
        plugin: Its type.
        names: Of its parameters.
        kinds: Of its children: "bsdf", "shape", ..., or "ref" where only a name is given.
        where: The scene, for the message.

    Raises:
        ValueError: If something is missing, or the plugin cannot be rendered.
    """
    if plugin in BROKEN:
        raise ValueError(f"{where} holds a {plugin!r}: {BROKEN[plugin]}")
    need = NEEDS.get(plugin)
    if need is not None and not need.met(names, kinds):
        raise ValueError(f"{where} holds a {plugin!r} without {need}, which Mitsuba cannot load; add it")
