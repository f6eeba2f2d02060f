"""Views that stay on disk, as not all pictures and feature maps of a large container fit into memory at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Shaped

from pipeline.artifact import Artifact


class StoredViews:
    """V pictures or feature maps of one array of an artifact, each read from disk on access.

    Raises the errors of `Artifact.read`.
    """

    def __init__(self, artifact: Artifact, name: str):
        self._read = artifact.parts(name)
        record = artifact.manifest.arrays[name]
        self.shape, self.dtype = record.shape, np.dtype(record.dtype)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, view: int) -> Shaped[np.ndarray, "H W C"]:
        return self._read(view)

    def __iter__(self) -> Iterator[Shaped[np.ndarray, "H W C"]]:
        return map(self._read, range(len(self)))


Views = Shaped[np.ndarray, "V H W C"] | StoredViews
"""Views in memory or on disk."""


def of_rows(views: Views, rows: Sequence[int]) -> Shaped[np.ndarray, "K H W C"]:
    """These K views, in memory; K = 0 is allowed."""
    chosen = [views[row] for row in rows]
    return np.stack(chosen) if chosen else np.empty((0, *views.shape[1:]), views.dtype)
