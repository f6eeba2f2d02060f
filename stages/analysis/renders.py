"""Renders of a container as anyone can make them: pictures from new cameras, and some of their feature maps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float16, UInt8

from pipeline.artifact import Artifact, ArtifactWriter
from stages.hiding.rendering import COVER, Rendering
from stages.imaging.pictures import tensor_to_picture
from stages.scene.alignment import sample
from stages.scene.attributes import string, strings

KIND = "renders"
COLORS = 3
"""What was blended in so few channels is the picture itself, and no feature map."""


@dataclass(frozen=True)
class Renders:
    """V pictures of one container along a path, and F_coup of F of its cameras, evenly spread.

    `feature_maps` have the container's M channels; F is 0, as M may be, where the method has no features. `method` is
    the container's.
    """

    method: str
    view_names: tuple[str, ...]
    pictures: UInt8[np.ndarray, "V H W 3"]
    feature_map_names: tuple[str, ...]
    feature_maps: Float16[np.ndarray, "F H W M"]


def collect_renders(
    method: str, view_names: Sequence[str], renderings: Iterable[Rendering], feature_maps: int
) -> Renders:
    """Renderings of one container, one a view, in order; no more than `feature_maps` of their maps are kept."""
    kept = set(sample(len(view_names), feature_maps).tolist())
    pictures, names, maps = [], [], []
    for number, rendering in enumerate(renderings):
        pictures.append(tensor_to_picture(rendering.pictures[COVER]))
        if number in kept and rendering.feature_map.shape[-1] > COLORS:
            names.append(view_names[number])
            maps.append(rendering.feature_map.cpu().numpy().astype(np.float16))
    height, width, _ = pictures[0].shape
    none = np.zeros((0, height, width, 0), np.float16)
    return Renders(method, tuple(view_names), np.stack(pictures), tuple(names), np.stack(maps) if maps else none)


def write_renders(writer: ArtifactWriter, renders: Renders) -> None:
    """Write a `renders` artifact."""
    writer.write("pictures", renders.pictures)
    if renders.feature_map_names:
        writer.write("feature_maps", renders.feature_maps)
    writer.attributes |= {
        "method": renders.method,
        "names": [*renders.view_names],
        "feature_map_names": [*renders.feature_map_names],
    }


def read_renders(artifact: Artifact) -> Renders:
    """Read a `renders` artifact."""
    pictures = artifact.read("pictures")
    names = strings(artifact, "feature_map_names")
    none = np.zeros((0, *pictures.shape[1:3], 0), np.float16)
    maps = artifact.read("feature_maps") if names else none
    return Renders(string(artifact, "method"), strings(artifact, "names"), pictures, names, maps)
