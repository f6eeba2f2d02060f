"""How many photos of each scene structure from motion placed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from pipeline.stage import Item


@dataclass(frozen=True)
class Placed:
    """`registered` of `total` photos are in the scene that the stage `stage` made."""

    stage: str
    registered: int
    total: int

    @property
    def left_out(self) -> int:
        return self.total - self.registered


def read_placed(scenes: Sequence[Item]) -> tuple[Placed, ...]:
    """The scenes that were made of photos, each once; others do not say how many there were."""
    found = {}
    for item in scenes:
        attributes = item.artifact.attributes if item.artifact else {}
        registered, total = attributes.get("registered"), attributes.get("total")
        if isinstance(registered, int) and isinstance(total, int):
            found[item.stage] = Placed(item.stage, registered, total)
    return tuple(found.values())


def public_scenes(scenes: Sequence[Item], stages: Collection[str]) -> list[Item]:
    """The public ones among scenes that the public `stages` made."""
    return [item for item in scenes if item.artifact and not item.artifact.private and item.stage in stages]
