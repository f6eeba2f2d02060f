"""The number of photos of each scene that structure from motion placed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from pipeline.stage import Item


@dataclass(frozen=True)
class Placed:
    """The scene made by the stage `stage` contains `registered` of `total` photos."""

    stage: str
    registered: int
    total: int

    @property
    def left_out(self) -> int:
        """The number of photos that are not in the scene."""
        return self.total - self.registered


def read_placed(scenes: Sequence[Item]) -> tuple[Placed, ...]:
    """The scenes made from photos, each once; other scenes do not record the numbers and are left out."""
    found = {}
    for item in scenes:
        attributes = item.artifact.attributes if item.artifact else {}
        registered, total = attributes.get("registered"), attributes.get("total")
        if isinstance(registered, int) and isinstance(total, int):
            found[item.stage] = Placed(item.stage, registered, total)
    return tuple(found.values())


def public_scenes(scenes: Sequence[Item], stages: Collection[str]) -> list[Item]:
    """The public scenes that are made by one of the public `stages`."""
    return [item for item in scenes if item.artifact and not item.artifact.private and item.stage in stages]
