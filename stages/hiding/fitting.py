"""Checking that untrusted files fit their method, before anything of the size that they claim is allocated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch

from pipeline.errors import UserError
from stages.hiding.method import LARGEST_SETTING, LONGEST_WORD, Method, build_method, is_setting
from stages.hiding.networks import PUBLIC_NETWORKS, SECRET_NETWORKS
from stages.hiding.weights import Weights
from stages.scene.gaussians import GEOMETRY

SHAPES: dict[str, tuple[int, ...]] = dict(zip(GEOMETRY, ((3,), (4,), (3,), ()), strict=True))
Shape = tuple[int, ...]


def fitted_method(
    where: object,
    name: str,
    settings: Mapping[str, object],
    messages: Sequence[str],
    shapes: Mapping[str, Shape],
    networks: Mapping[str, Weights],
) -> Method:
    """The method `name` with the weights of `networks`, which may lack the secret ones if there are no `messages`.

    `shapes` are those of one Gaussian's attributes. The method is first built on the meta device, then compared with
    the weights, then built: it takes no more memory than the weights themselves. Raises `UserError` for settings that
    the method does not have or that leave a network without channels; for weights that are missing, unknown or of other
    shapes; and for Gaussians that lack what the method renders or have an attribute with the name of a network.
    """
    check_settings(where, settings)
    full = dict(settings) | ({"messages": list(messages)} if messages else {})
    try:
        with torch.random.fork_rng(devices=[]):
            with torch.device("meta"):
                _check_networks(where, build_method(name, full), networks)
            method = build_method(name, full)
            for network, weights in networks.items():
                state = {weight: torch.from_numpy(values.copy()) for weight, values in weights.items()}
                method.networks[network].load_state_dict(state)
            needed = method.attribute_shapes()
    except (TypeError, ValueError, KeyError, AttributeError, RuntimeError, OverflowError) as error:
        raise UserError(
            f"the settings are none of the method {name}",
            where=where,
            found=f"{str(settings)[:200]} ({str(error)[:100]!r})",
            expected="those with which a container was trained",
        ) from error
    _check_attributes(where, SHAPES | needed, shapes)
    return method


def check_settings(where: object, settings: Mapping[str, object]) -> None:
    """Raise `UserError` for values that no method can have as settings: they must be short words or bounded numbers."""
    for name, value in settings.items():
        if not is_setting(value):
            raise UserError(
                f"the setting {name[:LONGEST_WORD]!r} is none",
                where=where,
                found=repr(value)[:LONGEST_WORD],
                expected=f"a number up to {LARGEST_SETTING}, or a word",
            )


def _check_networks(where: object, method: Method, networks: Mapping[str, Weights]) -> None:
    for network in networks.keys() - method.networks.keys():
        raise UserError(
            f"weights of {network}, which the method {method.name} does not have with these messages",
            where=where,
            expected=f"{', '.join(method.networks) or 'no weights'}",
            remedy="Take them out, or check which files belong together.",
        )
    for network, module in method.networks.items():
        expected = {weight: tuple(tensor.shape) for weight, tensor in module.state_dict().items()}
        if any(0 in shape for shape in expected.values()):
            raise ValueError(f"{network} would have no channels")
        found = {weight: values.shape for weight, values in networks.get(network, {}).items()}
        if not found:
            raise UserError(
                f"the weights of {network} are missing",
                where=where,
                expected=f"{network}.safetensors beside the other files of its bundle",
                remedy="Give the folder of the bundle as it was exported, not one of its files.",
            )
        if found != expected:
            raise UserError(
                f"the weights of {network} do not fit the method {method.name} with its settings",
                where=where,
                found=_difference(found, expected),
                expected=_difference(expected, found),
                remedy="Give the files of one container, and its own secret.",
            )


def _difference(these: Mapping[str, Shape], those: Mapping[str, Shape]) -> str:
    """The first few weights that only `these` have, or have in another shape."""
    only = [f"{name[:LONGEST_WORD]!r} {shape}" for name, shape in sorted(these.items()) if those.get(name) != shape]
    return ", ".join(only[:3]) or "nothing else"


def _check_attributes(where: object, needed: Mapping[str, Shape], shapes: Mapping[str, Shape]) -> None:
    for name in sorted(shapes.keys() & {*PUBLIC_NETWORKS, *SECRET_NETWORKS}):
        raise UserError(f"the Gaussians' attribute {name!r} has the name of a network", where=where)
    for name, shape in needed.items():
        if shapes.get(name) != shape:
            raise UserError(
                f"the Gaussians' attribute {name!r} is not what the method renders",
                where=where,
                found=f"{math.prod(shapes[name])} values a Gaussian, as {shapes[name]}"
                if name in shapes
                else "nothing",
                expected=f"{math.prod(shape)} values a Gaussian, as {shape}",
            )
