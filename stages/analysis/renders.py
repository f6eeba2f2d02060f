"""Renders that anyone can make of a container: pictures from new cameras, and some of their feature maps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from pipeline.artifact import Artifact, ArtifactWriter
from stages.analysis.stored_views import StoredViews, Views
from stages.hiding.rendering import COVER, Rendering
from stages.imaging.pictures import tensor_to_picture
from stages.scene.alignment import sample
from stages.scene.attributes import string, strings

KIND = "renders"
COLORS = 3
"""With at most this many blended channels, the feature map is the picture itself and is not stored."""


@dataclass(frozen=True)
class Renders:
    """V uint8 pictures of one container along a camera path, and F_coup in float16 for F evenly spread ones of them.

    `feature_maps` are [F, H, W, M]; F is 0, and M may be, if the method has no features. `method` is the container's.
    """

    method: str
    view_names: tuple[str, ...]
    pictures: Views
    feature_map_names: tuple[str, ...]
    feature_maps: Views


def collect_renders(
    method: str, view_names: Sequence[str], renderings: Iterable[Rendering], feature_maps: int
) -> Renders:
    """Collect renderings of one container, one per view in order, with at most `feature_maps` of their feature maps."""
    kept = sample(len(view_names), feature_maps).tolist()
    pictures, maps = np.zeros((0, 0, 0, COLORS), np.uint8), np.zeros((0, 0, 0, 0), np.float16)
    for number, rendering in enumerate(renderings):
        if number == 0:
            pictures, maps = _room(rendering, len(view_names), len(kept))
        pictures[number] = tensor_to_picture(rendering.pictures[COVER])
        if number in kept and len(maps):
            maps[kept.index(number)] = rendering.feature_map.cpu().numpy()
    names = tuple(view_names[number] for number in kept[: len(maps)])
    return Renders(method, tuple(view_names), pictures, names, maps)


def _room(first: Rendering, views: int, feature_maps: int) -> tuple[UInt8[np.ndarray, "V H W 3"], np.ndarray]:
    """Uninitialised arrays for all pictures and feature maps. They take gigabytes, which stacking would double."""
    height, width, channels = first.feature_map.shape
    is_more = channels > COLORS
    maps = np.empty((feature_maps, height, width, channels) if is_more else (0, height, width, 0), np.float16)
    return np.empty((views, *first.pictures[COVER].shape), np.uint8), maps


def write_renders(writer: ArtifactWriter, renders: Renders) -> None:
    """Write a `renders` artifact."""
    writer.write("pictures", np.asarray(renders.pictures))
    if renders.feature_map_names:
        writer.write("feature_maps", np.asarray(renders.feature_maps))
    writer.attributes |= {
        "method": renders.method,
        "names": [*renders.view_names],
        "feature_map_names": [*renders.feature_map_names],
    }


def read_renders(artifact: Artifact) -> Renders:
    """Read a `renders` artifact; its views stay on disk until they are accessed."""
    pictures = StoredViews(artifact, "pictures")
    names = strings(artifact, "feature_map_names")
    none = np.zeros((0, *pictures.shape[1:3], 0), np.float16)
    maps = StoredViews(artifact, "feature_maps") if names else none
    return Renders(string(artifact, "method"), strings(artifact, "names"), pictures, names, maps)
