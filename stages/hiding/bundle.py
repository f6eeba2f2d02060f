"""Bundles: a container, and apart from it its secret, as files that other programs read.

    container.ply                 the Gaussians: raw values, with 3DGS's names where it has some
    container.json                method, settings and attributes, and what the renderer makes of each column
    scene_decoder.safetensors     D_s, where the method has one
    cameras.json                  a path from which to look at it, where the cover was given; see `camera_files`

    secret.json                   the messages' names, in the order of the message decoder's channels, and other facts
    message_decoder.safetensors   D_m, where the method has one
    image_camera.json             the camera from which a picture is seen, where one is hidden and the cover was given

What is public tells nothing of messages, neither names nor number; only a method whose Gaussians carry attributes of
each message (`sh`) cannot but show them, as it does in the store.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.hiding.columns import activations, columns_of
from stages.hiding.networks import PUBLIC_NETWORKS, SECRET_NETWORKS
from stages.hiding.weights import SUFFIX, Weights, weights_file
from stages.scene.attributes import mapping, string, strings
from stages.scene.gaussians import GEOMETRY
from stages.scene.ply.writing import write_ply

CONTAINER_FORMAT, SECRET_FORMAT = "gs-hider container", "gs-hider secret"
VERSION = 1
GAUSSIANS, DESCRIPTION, SECRET_DESCRIPTION = "container.ply", "container.json", "secret.json"
CAMERAS, IMAGE_CAMERA = "cameras.json", "image_camera.json"
IN_COMMENT = "description "
"""Before the description in the PLY itself, so that where a method has no networks the PLY alone is a container."""


@dataclass(frozen=True)
class ContainerBundle:
    """What a container's files hold: attributes [N, ...] as stored, and weights of the public networks by their names.

    `method` and `settings` are those from which the method is built again.
    """

    method: str
    settings: Mapping[str, Any]
    attributes: Mapping[str, Float32[np.ndarray, "N ..."]]
    networks: Mapping[str, Weights] = field(default_factory=dict)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of one Gaussian's attributes."""
        return {name: values.shape[1:] for name, values in sorted(self.attributes.items())}


@dataclass(frozen=True)
class SecretBundle:
    """The messages' names in the order of the message decoder's channels, and the weights of the secret networks.

    `facts` is what else the secret says of itself, numbers and words.
    """

    messages: tuple[str, ...]
    networks: Mapping[str, Weights] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


def container_bundle(container: Artifact) -> ContainerBundle:
    """What is to be exported of a `container`, or of `splats`."""
    attributes = {name: container.read(name) for name in container.names if "/" not in name}
    networks = _networks(container, PUBLIC_NETWORKS)
    return ContainerBundle(string(container, "method"), mapping(container, "settings"), attributes, networks)


def secret_bundle(secret: Artifact) -> SecretBundle:
    """What is to be exported of a `secret`."""
    facts = {name: value for name, value in secret.attributes.items() if name != "messages"}
    return SecretBundle(strings(secret, "messages"), _networks(secret, SECRET_NETWORKS), facts)


def _networks(artifact: Artifact, names: Sequence[str]) -> Mapping[str, Weights]:
    """The weights of those networks that the artifact holds."""
    networks: dict[str, dict[str, np.ndarray]] = {}
    for array in artifact.names:
        network, _, weight = array.partition("/")
        if network in names:
            networks.setdefault(network, {})[weight] = artifact.read(array)
    return networks


def write_container_bundle(writer: ArtifactWriter, bundle: ContainerBundle) -> None:
    """Write the public files. Raises `UserError` as `write_gaussians` does."""
    write_gaussians(writer.path_for(GAUSSIANS), bundle)
    description = _description(bundle) | {"columns": activations(bundle.shapes)}
    writer.write_file(DESCRIPTION, json.dumps(description, indent=1) + "\n")
    _write_networks(writer, bundle.networks)


def write_secret_bundle(writer: ArtifactWriter, bundle: SecretBundle) -> None:
    """Write the secret files; without messages they say that there are none."""
    description: dict[str, Any] = {"format": SECRET_FORMAT, "version": VERSION, "messages": [*bundle.messages]}
    description |= {"facts": dict(bundle.facts)} if bundle.facts else {}
    writer.write_file(SECRET_DESCRIPTION, json.dumps(description, indent=1) + "\n")
    _write_networks(writer, bundle.networks)


def write_gaussians(path: Path, bundle: ContainerBundle) -> None:
    """Write a PLY that says in its comments which container it is, and what the renderer makes of its values.

    Raises `UserError` for what could not be read again: a value that is no finite float32, attributes of different
    numbers of rows, and names that are none of columns.
    """
    _check_attributes(bundle)
    description = IN_COMMENT + json.dumps(_description(bundle), sort_keys=True)
    said = [f"{columns}: {activation}" for columns, activation in activations(bundle.shapes).items()]
    try:
        write_ply(path, columns_of(bundle.attributes), [description, *said])
    except ValueError as error:
        raise UserError("the Gaussians' attributes cannot be exported", found=error) from error


def _description(bundle: ContainerBundle) -> dict[str, Any]:
    return {
        "format": CONTAINER_FORMAT,
        "version": VERSION,
        "method": bundle.method,
        "settings": dict(bundle.settings),
        "attributes": {name: list(shape) for name, shape in bundle.shapes.items()},
    }


def _check_attributes(bundle: ContainerBundle) -> None:
    counts = {name: values.shape[0] if values.ndim else None for name, values in bundle.attributes.items()}
    if len(set(counts.values())) != 1 or not counts.keys() >= set(GEOMETRY):
        raise UserError(
            "the Gaussians' attributes cannot be exported",
            found=f"rows: {counts}",
            expected=f"as many rows of each, {', '.join(GEOMETRY)} among them",
        )
    for name, values in bundle.attributes.items():
        if values.dtype != np.float32 or not np.isfinite(values).all():
            raise UserError(
                f"the attribute {name!r} cannot be exported",
                found=f"type {values.dtype}" if values.dtype != np.float32 else "NaN or infinity",
                expected="finite numbers of type float32",
                remedy="Train again, with smaller learning rates if it comes to this once more.",
            )


def _write_networks(writer: ArtifactWriter, networks: Mapping[str, Weights]) -> None:
    for name, weights in networks.items():
        writer.write_file(f"{name}{SUFFIX}", weights_file(weights))
