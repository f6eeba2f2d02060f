"""What a method of hiding is, and how a stage loads the one that its parameters name."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Protocol, cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import UserError
from stages.hiding.rendering import Rendering
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians

PACKAGE = "stages.hiding.methods"
LARGEST_SETTING = 1024
"""What a number among a method's settings is at most: beyond it no container is trained, and none imported."""


class Method(Protocol):
    """How Gaussians become pictures: the attributes it adds to them, its networks, and its rendering.

    `name` is that of its module in `methods/`. `settings` are the JSON values from which `build` makes the same method
    again; they travel with the container. `learning_rates` gives Adam's rate for every attribute. `networks` are
    trained beside the Gaussians.
    """

    name: str
    settings: Mapping[str, int | float | str]
    learning_rates: Mapping[str, float]
    networks: Mapping[str, torch.nn.Module]

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Attributes of N new Gaussians that look so in every picture, by its name: sRGB in [0, 1], 0.5 if unknown."""

    def attribute_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each attribute of one Gaussian, however it started: those of `learning_rates`."""

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """The pictures `wanted` of one camera, or all; `progress` in [0, 1] is the share of the training that is done.

        What is not wanted may be there all the same, where leaving it out would save nothing.
        """

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """What a training adds to the loss of all its views together, as a prior is: a step, which sees one view, adds
        its share. The fewer photos there are, the more it counts. None: nothing, as in the paper.
        """


def module_of(name: str) -> str:
    """The module that holds method `name`: what a stage declares to the code fingerprint."""
    return f"{PACKAGE}.{name}"


def refuse_another_method(where: Path, found: str, declared: str) -> None:
    """Raise `UserError` unless the container at `where` was made by the method that a stage declared.

    The declaration decides whose code the stage's results depend on, and under which name they appear.
    """
    if found != declared:
        raise UserError(
            "the container was made by another method",
            where=where,
            found=found,
            expected=declared,
            remedy=f"set the method of every stage that takes it to {found}: --set method={found} where a workflow has "
            "that variable",
        )


def settings_of(name: str) -> tuple[str, ...]:
    """The settings from which method `name` is built, beside its messages."""
    return tuple(importlib.import_module(module_of(name)).SETTINGS)


def build_method(name: str, settings: Mapping[str, object]) -> Method:
    """The method `name`, made from its settings. Its networks' weights are drawn from torch's global generator."""
    return cast(Method, importlib.import_module(module_of(name)).build(settings))


def move_networks(method: Method, device: torch.device | str) -> None:
    """Put the method's networks on a device, that of the Gaussians which it is to render."""
    for network in method.networks.values():
        network.to(device)
