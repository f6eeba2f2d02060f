"""Splats, containers and secrets in the store: Gaussians together with the method that renders them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from stages.hiding.image_view import IMAGE_VIEW
from stages.hiding.method import Method, build_method, move_networks, refuse_another_method
from stages.hiding.networks import PUBLIC_NETWORKS, SECRET_NETWORKS
from stages.hiding.stored_arrays import attributes_of, weights_of
from stages.scene.attributes import mapping, string, strings
from stages.scene.gaussians import Gaussians
from stages.scene.world_scale import refuse_other_world


def write_container(writer: ArtifactWriter, gaussians: Gaussians, method: Method) -> None:
    """Write Gaussians, the method's name and settings, and its public networks: all that a renderer needs.

    Nothing about messages is written: neither their decoder nor their names or number. Rows are sorted by position,
    since the order in which Gaussians were created would reveal which of them started as a message's.
    """
    order = np.lexsort(gaussians.means.detach().cpu().numpy().T)
    for parameter, tensor in gaussians.parameters.items():
        writer.write(parameter, tensor.detach().cpu().numpy()[order])
    writer.attributes.update(method=method.name, settings=dict(method.settings), gaussians=len(gaussians))
    _write_networks(writer, method, PUBLIC_NETWORKS)


def write_secret(
    writer: ArtifactWriter, method: Method, messages: Sequence[str], image_view: str | None = None
) -> None:
    """Write the message decoder and the messages' names, in the order of its output channels.

    `image_view` is the view that hides the message, if that is an image.
    """
    writer.attributes.update(messages=list(messages), **({IMAGE_VIEW: image_view} if image_view else {}))
    _write_networks(writer, method, SECRET_NETWORKS)


def read_gaussians(artifact: Artifact, device: torch.device | str = "cpu") -> Gaussians:
    """Read the Gaussians of `splats` or of a `container` onto a device."""
    return Gaussians({name: torch.from_numpy(values) for name, values in attributes_of(artifact).items()}).to(device)


def read_method(container: Artifact, secret: Artifact | None = None, device: torch.device | str = "cpu") -> Method:
    """The method that renders a container, and with the secret its messages, too. Networks are frozen, on `device`.

    Raises `UserError` if weights in the artifacts are missing or do not fit the method: initial weights would show
    something else every time.
    """
    settings = mapping(container, "settings")
    if secret is not None:
        settings["messages"] = list(strings(secret, "messages"))
    with torch.random.fork_rng(devices=[]):
        method = build_method(string(container, "method"), settings)
    for artifact, names in ((container, PUBLIC_NETWORKS), (secret, SECRET_NETWORKS)):
        if artifact is not None:
            _read_networks(artifact, method, names)
    for network in method.networks.values():
        network.requires_grad_(False)
    move_networks(method, device)
    return method


def check_method(container: Artifact, declared: str) -> None:
    """Raise `UserError` unless the container was made by the method that a stage declared."""
    refuse_another_method(container.path, string(container, "method"), declared)


def check_drawn(drawn: Artifact, method: str, scene: Artifact) -> None:
    """Raise `UserError` unless `drawn`, a container or splats, may be drawn from the cameras of a `scene`.

    It must have been made by the method that a stage declared, and stand in the scene's world.
    """
    check_method(drawn, method)
    refuse_other_world(drawn, scene)


def bytes_of(artifact: Artifact) -> int:
    """The uncompressed bytes of all arrays: a container's Gaussians and public networks, or a secret's networks."""
    return sum(int(np.prod(array.shape)) * array.dtype.itemsize for array in map(artifact.open, artifact.names))


def _write_networks(writer: ArtifactWriter, method: Method, names: Sequence[str]) -> None:
    for name in names:
        network = method.networks.get(name)
        for weight, tensor in network.state_dict().items() if network is not None else ():
            writer.write(f"{name}/{weight}", tensor.contiguous().cpu().numpy())


def _read_networks(artifact: Artifact, method: Method, names: Sequence[str]) -> None:
    weights = {
        network: {name: torch.from_numpy(values) for name, values in own.items()}
        for network, own in weights_of(artifact).items()
    }
    for name in (*weights, *(name for name in names if name in method.networks and name not in weights)):
        _load(method.networks, name, weights.get(name, {}), artifact)


def _load(
    networks: Mapping[str, torch.nn.Module], name: str, state: Mapping[str, torch.Tensor], artifact: Artifact
) -> None:
    try:
        networks[name].load_state_dict(state)
    except (KeyError, RuntimeError) as error:
        raise UserError(
            f"the weights of {name} do not fit the container's method",
            where=str(artifact.path),
            found=str(error).splitlines()[0],
            expected="the artifacts of one training",
            remedy="give the secret that was made together with this container",
        ) from error
