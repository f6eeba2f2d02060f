"""What a method of hiding is, and how a stage loads the one that its parameters name."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping
from pathlib import Path
from types import ModuleType
from typing import Protocol, cast, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.errors import UserError
from stages.hiding.method_names import method_names, module_of
from stages.hiding.networks import PUBLIC_NETWORKS, SECRET_NETWORKS
from stages.hiding.rendering import Rendering
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians

LARGEST_SETTING = 1024
"""What a number among a method's settings is at most: beyond it no container is trained, and none imported."""

LONGEST_WORD = 100
"""Among a method's settings, in characters."""

Setting = int | float | str
"""As JSON has it: it travels with the container."""


class Method(Protocol):
    """How Gaussians become pictures: the attributes it adds to them, its networks, and its rendering.

    `name` is that of its module in `methods/`. `settings` are the JSON values from which `build` makes the same method
    again; they travel with the container. `messages` are the names of those it shows: none where the secret is not at
    hand. `learning_rates` gives Adam's rate for every attribute; of `coupled.FEATURES` it is the parameter
    `feature_rate` while something is hidden. `networks` are trained beside the Gaussians: `scene_decoder`, which is
    published, and `message_decoder`, which is not (`networks.py`), and no others.
    """

    name: str
    settings: Mapping[str, Setting]
    messages: tuple[str, ...]
    learning_rates: Mapping[str, float]
    networks: Mapping[str, torch.nn.Module]

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Attributes of N new Gaussians that look so in every picture, by its name: sRGB in [0, 1], 0.5 if unknown.

        Decoders may be set so that they show these colours; what is random in it is drawn from `generator`, which
        follows from the key where there is one.
        """

    def attribute_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each attribute of one Gaussian, however it started: those of `learning_rates`."""

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """The pictures `wanted` of one camera, or all; `progress` in [0, 1] is the share of the schedules that is done.

        What is not wanted may be there all the same, where leaving it out would save nothing.
        """

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """What a training adds to the loss of all its views together, as a prior is: a step, which sees one view, adds
        its share. The fewer photos there are, the more it counts. None: nothing, as in the paper.
        """


@runtime_checkable
class DrawsDirections(Protocol):
    """A method whose decoders read features along directions that torch draws no weights for; see `homogeneous`."""

    def draw_directions(self, generator: np.random.Generator) -> None:
        """Have the decoders read along random directions, for features that start with zeros.

        In place of `initial_attributes`; as there, what is random is drawn from `generator`.
        """


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


def _loaded(name: str) -> ModuleType:
    """The module of method `name`. Raises `UserError` for one that cannot be imported, which may be the user's own."""
    try:
        return importlib.import_module(module_of(name))
    except Exception as error:
        raise UserError(
            "a method cannot be loaded",
            where=module_of(name),
            found=f"{type(error).__name__}: {error}",
            expected="a module with SETTINGS and build, as those beside it",
        ) from error


def settings_of(name: str) -> tuple[str, ...]:
    """The settings from which method `name` is built, beside its messages. Raises `UserError` where it names none."""
    settings = getattr(_loaded(name), "SETTINGS", None)
    if not isinstance(settings, tuple):
        raise UserError(
            "a method does not say what it is built from",
            where=module_of(name),
            found=f"SETTINGS = {settings!r}",
            expected='a tuple of names, as ("feature_dim", "layers"), or ()',
        )
    return settings


def is_setting(value: object) -> bool:
    """Whether a method may have it among its settings: a number up to `LARGEST_SETTING`, or a short word."""
    if isinstance(value, str):
        return value.isprintable() and len(value) <= LONGEST_WORD
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_SETTING


def presets_of(name: str, hides_scenes: bool) -> dict[str, Setting]:
    """What trainings of method `name` take where nothing is stated: its `PRESETS`, and where scenes are hidden its
    `SCENE_PRESETS` before them. A method that has none takes the parameters' defaults; so does one that is not there.
    """
    if name not in method_names():
        return {}
    module = _loaded(name)
    presets: dict[str, Setting] = dict(getattr(module, "PRESETS", {}))
    return presets | (dict(getattr(module, "SCENE_PRESETS", {})) if hides_scenes else {})


def build_method(name: str, settings: Mapping[str, object]) -> Method:
    """The method `name`, made from its settings. Its networks' weights are drawn from torch's global generator.

    Raises `UserError` for networks that no artifact would hold.
    """
    method = cast(Method, _loaded(name).build(settings))
    kept = (*PUBLIC_NETWORKS, *SECRET_NETWORKS)
    if lost := method.networks.keys() - {*kept}:
        raise UserError(
            "a method has networks that neither the container nor the secret holds",
            where=module_of(name),
            found=", ".join(sorted(lost)),
            expected=" and ".join(kept),
            remedy="Make what everybody may have a part of the scene decoder, and the rest one of the message decoder.",
        )
    return method


def move_networks(method: Method, device: torch.device | str) -> None:
    """Put the method's networks on a device, that of the Gaussians which it is to render."""
    for network in method.networks.values():
        network.to(device)
