"""Bundles: a container and, in a separate folder, its secret, as files that other programs can read.

    container.ply                 the Gaussians: raw values, under 3DGS's column names where it has one
    container.json                method, settings and attributes, and the activation of each column
    scene_decoder.safetensors     D_s, if the method has one
    cameras.json                  a camera path for viewing it, if the cover was given; see `camera_files`

    secret.json                   the messages' names, in the order of the message decoder's channels, a hash of the
                                  container (`container_hash`), and other facts
    message_decoder.safetensors   D_m, if the method has one
    image_camera.json             the camera that sees the hidden image, if there is one and the cover was given

The public files state nothing about the messages, neither their names nor their number. A method whose Gaussians carry
attributes for each message (`sh`) is the exception: its files show them, as its containers in the store do. The number
may also be inferred: with three or more messages in sixteen channels, `homogeneous` cannot start its scene decoder
along orthogonal directions, as it does with fewer.
"""

from __future__ import annotations

import hashlib
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
from stages.hiding.stored_arrays import attributes_of, weights_of
from stages.hiding.weights import SUFFIX, Weights, weights_file
from stages.scene.attributes import mapping, string, strings
from stages.scene.gaussians import GEOMETRY
from stages.scene.ply.writing import write_ply

CONTAINER_FORMAT, SECRET_FORMAT = "gs-hider container", "gs-hider secret"
VERSION = 1
GAUSSIANS, DESCRIPTION, SECRET_DESCRIPTION = "container.ply", "container.json", "secret.json"
CAMERAS, IMAGE_CAMERA = "cameras.json", "image_camera.json"
EXPORTED_WITH = "container_sha256"
"""Fact of a secret: the hash of its container. A seal keeps others from reading the features, not from changing them,
and so what the secret shows; whoever alters the container cannot alter this."""
IN_COMMENT = "description "
"""Prefix of the PLY comment that holds the description. It makes the PLY alone a container if the method has no
networks."""


@dataclass(frozen=True)
class ContainerBundle:
    """A container's files: attributes [N, ...] as stored, and the public networks' weights by network name.

    `method` and `settings` are what the method is rebuilt from.
    """

    method: str
    settings: Mapping[str, Any]
    attributes: Mapping[str, Float32[np.ndarray, "N ..."]]
    networks: Mapping[str, Weights] = field(default_factory=dict)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each attribute of one Gaussian, sorted by name."""
        return {name: values.shape[1:] for name, values in sorted(self.attributes.items())}


@dataclass(frozen=True)
class SecretBundle:
    """The messages' names in the order of the message decoder's channels, and the weights of the secret networks.

    `facts` are the secret's other attributes: numbers, lists of numbers, and words.
    """

    messages: tuple[str, ...]
    networks: Mapping[str, Weights] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


def container_bundle(container: Artifact) -> ContainerBundle:
    """The bundle of a `container` or `splats` artifact."""
    method, settings = string(container, "method"), mapping(container, "settings")
    return ContainerBundle(method, settings, attributes_of(container), _networks(container, PUBLIC_NETWORKS))


def secret_bundle(secret: Artifact, container: ContainerBundle) -> SecretBundle:
    """The bundle of a `secret` artifact that is exported with this container."""
    facts = {name: value for name, value in secret.attributes.items() if name != "messages"}
    facts[EXPORTED_WITH] = container_hash(container)
    return SecretBundle(strings(secret, "messages"), _networks(secret, SECRET_NETWORKS), facts)


def container_hash(container: ContainerBundle) -> str:
    """SHA-256 of all that a container shows: description, Gaussians, and public networks. N = 0 is allowed.

    Gaussians count in the order in which the store has them, since programs may save them in another.
    """
    order = np.lexsort(container.attributes["means"].T)
    weights = {f"{name}/{key}": value for name, own in container.networks.items() for key, value in own.items()}
    digest = hashlib.sha256(json.dumps(_description(container), sort_keys=True).encode())
    for name, values in sorted({**container.attributes, **weights}.items()):
        own = values[order] if name in container.attributes else values
        digest.update(f"{name} {values.shape}".encode())
        digest.update(np.ascontiguousarray(own, "<f4").ravel().data)  # `tobytes` would copy it
    return digest.hexdigest()


def _networks(artifact: Artifact, names: Sequence[str]) -> Mapping[str, Weights]:
    """The weights of those of the named networks that the artifact holds."""
    return {name: weights for name, weights in weights_of(artifact).items() if name in names}


def write_container_bundle(writer: ArtifactWriter, bundle: ContainerBundle) -> None:
    """Write the public files. Raises `UserError` like `write_gaussians`."""
    write_gaussians(writer.path_for(GAUSSIANS), bundle)
    description = _description(bundle) | {"columns": activations(bundle.shapes)}
    writer.write_file(DESCRIPTION, json.dumps(description, indent=1) + "\n")
    _write_networks(writer, bundle.networks)


def write_secret_bundle(writer: ArtifactWriter, bundle: SecretBundle) -> None:
    """Write the secret files. Without messages, they state that there are none."""
    description: dict[str, Any] = {"format": SECRET_FORMAT, "version": VERSION, "messages": [*bundle.messages]}
    description |= {"facts": dict(bundle.facts)} if bundle.facts else {}
    writer.write_file(SECRET_DESCRIPTION, json.dumps(description, indent=1) + "\n")
    _write_networks(writer, bundle.networks)


def write_gaussians(path: Path, bundle: ContainerBundle) -> None:
    """Write a PLY whose comments describe the container and the activation of each column.

    Raises `UserError` for anything that could not be read back: values that are not finite float32, attributes with
    different numbers of rows, missing geometry, and names that cannot be columns.
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
