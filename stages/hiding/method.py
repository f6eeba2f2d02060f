"""The interface of hiding methods, and loading the method that a stage's parameters name."""

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
from stages.hiding.words import WORD
from stages.scene.cameras import Camera
from stages.scene.gaussians import Gaussians

LARGEST_SETTING = 1024
"""Largest magnitude of a number among a method's settings: containers beyond it are neither trained nor imported."""

LONGEST_WORD = 100
"""Largest number of characters of a word among a method's settings."""

Setting = int | float | str
"""A JSON value: settings travel with the container."""


class Method(Protocol):
    """How Gaussians become pictures: the attributes that the method adds to them, its networks, and its rendering.

    `name` is that of its module in `methods/`. `settings` are the JSON values from which `build` makes the same method
    again; they travel with the container. `messages` are the names of the messages it shows: none without the secret.
    `learning_rates` gives Adam's rate for each attribute; for `coupled.FEATURES`, the parameter `feature_rate` replaces
    it while something is being hidden. `networks` are trained jointly with the Gaussians; only `scene_decoder`, which
    is published, and `message_decoder`, which is secret, are allowed (`networks.py`).
    """

    name: str
    settings: Mapping[str, Setting]
    messages: tuple[str, ...]
    learning_rates: Mapping[str, float]
    networks: Mapping[str, torch.nn.Module]

    def initial_attributes(
        self, colors: Mapping[str, Float[np.ndarray, "N 3"]], generator: np.random.Generator
    ) -> dict[str, Float[Tensor, "N ..."]]:
        """Attributes of N new Gaussians that show the given colours, by picture name: sRGB in [0, 1], 0.5 if unknown.

        May initialise the decoders so that they show these colours. All randomness comes from `generator`, which is
        seeded with the key if there is one.
        """

    def attribute_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each attribute of one Gaussian, whatever its initial value; names as in `learning_rates`."""

    def render(
        self, gaussians: Gaussians, camera: Camera, progress: float = 1.0, wanted: Collection[str] | None = None
    ) -> Rendering:
        """Render the `wanted` pictures of one camera, or all of them.

        `progress` in [0, 1] is the completed share of the schedules. Pictures that are not wanted may be returned as
        well, if omitting them would save nothing.
        """

    def penalty(self, gaussians: Gaussians) -> Float[Tensor, ""] | None:
        """A term of the loss over all training views together, like a prior; None for no term, as in the paper.

        Each step sees one of the views and adds that view's share. The fewer photos there are, the more the term
        counts.
        """


@runtime_checkable
class DrawsDirections(Protocol):
    """A method whose decoders read along directions that torch's initialisation does not draw; see `homogeneous`."""

    def draw_directions(self, generator: np.random.Generator) -> None:
        """Set the decoders' directions at random, for features that start at zero.

        Called instead of `initial_attributes`. As there, all randomness comes from `generator`.
        """


@runtime_checkable
class ReadsRenders(Protocol):
    """A method whose message decoder reads the cover's rendered picture; see `hiding.methods.decoder`."""

    def read_off(self, picture: Float[Tensor, "H W 3"]) -> Mapping[str, Float[Tensor, "H W 3"]]:
        """The messages by name, unclamped, in the order of `messages`, decoded from a picture of the cover."""


def refuse_another_method(where: Path, found: str, declared: str) -> None:
    """Raise `UserError` unless the method that made the container at `where` is the one that a stage declared.

    The declaration determines whose code the stage's results depend on, and under which name they are reported.
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
    """Import the module of method `name`, which may be the user's own. Raises `UserError` if that fails."""
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
    """The names of the settings that method `name` is built from, besides its messages.

    Raises `UserError` if its module does not declare them, or has no function `build`.
    """
    module = _loaded(name)
    if not callable(getattr(module, "build", None)):
        raise UserError("a method cannot be built", where=module_of(name), expected="a function build(settings)")
    settings = getattr(module, "SETTINGS", None)
    if not isinstance(settings, tuple):
        raise UserError(
            "a method does not say what it is built from",
            where=module_of(name),
            found=f"SETTINGS = {settings!r}",
            expected='a tuple of names, as ("feature_dim", "layers"), or ()',
        )
    return settings


def is_setting(value: object) -> bool:
    """Whether a method may have this value among its settings: a number up to `LARGEST_SETTING`, or a short word."""
    if isinstance(value, str):
        return value.isprintable() and len(value) <= LONGEST_WORD
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_SETTING


def presets_of(name: str, hides_scenes: bool) -> dict[str, Setting]:
    """Parameters of method `name` that replace the general defaults.

    These are its `PRESETS` and, if scenes are hidden, its `SCENE_PRESETS`, which take precedence. Empty for a method
    without presets, and for one that does not exist.
    """
    if name not in method_names():
        return {}
    module = _loaded(name)
    presets: dict[str, Setting] = dict(getattr(module, "PRESETS", {}))
    return presets | (dict(getattr(module, "SCENE_PRESETS", {})) if hides_scenes else {})


def build_method(name: str, settings: Mapping[str, object]) -> Method:
    """Build method `name` from its settings. Its networks' weights are drawn from torch's global generator.

    Raises `UserError` for networks that neither the container nor the secret would store, and for what would keep the
    method from being built again by its name and settings: it would be noticed after the training, or never.
    """
    method = cast(Method, _loaded(name).build(settings))
    _check_built(name, method, {key: value for key, value in settings.items() if key != "messages"})
    kept = (*PUBLIC_NETWORKS, *SECRET_NETWORKS)
    if lost := method.networks.keys() - {*kept}:
        raise UserError(
            "a method has networks that neither the container nor the secret holds",
            where=module_of(name),
            found=", ".join(sorted(lost)),
            expected=" and ".join(kept),
            remedy="Make what may be public a part of the scene decoder, and the rest one of the message decoder.",
        )
    return method


def build_to_train(name: str, settings: Mapping[str, object]) -> Method:
    """Build method `name` as `build_method` does, for a container that is to be trained, exported and imported.

    Besides what `build_method` refuses, raises `UserError` for what `import_container` would refuse after the training:
    a name of the method or of an attribute that is no `WORD`, and a method that cannot be built on torch's meta device,
    where the sizes in a file are checked before memory is allocated.
    """
    method = build_method(name, settings)
    if refused := [each for each in (name, *method.attribute_shapes()) if not WORD.fullmatch(each)]:
        raise UserError(
            "a method's containers could not be imported",
            where=module_of(name),
            found=f"the name {refused[0]!r}",
            expected="methods and attributes named by a small letter and up to 63 small letters, digits or underscores",
            remedy="rename it: a method is named by its file and by `name`, an attribute wherever the method has it",
        )
    try:
        with torch.device("meta"):
            build_method(name, settings)
    except Exception as error:
        raise UserError(
            "a method's containers could not be imported",
            where=module_of(name),
            found=f"{type(error).__name__}: {error}",
            expected="a method that is also built on torch's meta device, where tensors have no values",
            remedy='compute what the method is built from without torch, or with device="cpu"',
        ) from error
    return method


def _check_built(name: str, method: Method, settings: Mapping[str, object]) -> None:
    """Refuse a method with another name or other settings than asked for, or with networks that it does not list."""
    listed = {id(module) for network in method.networks.values() for module in network.modules()}
    own = {key: value for key, value in vars(method).items() if isinstance(value, torch.nn.Module)}
    learnt = [key for key, network in own.items() if id(network) not in listed and [*network.parameters()]]
    changed = [key for key, value in settings.items() if key not in method.settings or method.settings[key] != value]
    if method.name == name and not changed and not learnt:
        return
    found = [f"name = {method.name!r}"] if method.name != name else []
    found += [f"settings without {key} = {settings[key]!r}" for key in changed]
    found += [f"networks without {key}" for key in learnt]
    raise UserError(
        "a method could not be built again from what is stored of it",
        where=module_of(name),
        found=", ".join(found),
        expected=f"name = {name!r}, settings with all that build was given, and in networks whatever is learnt",
    )


def move_networks(method: Method, device: torch.device | str) -> None:
    """Move the method's networks to the device of the Gaussians that it will render."""
    for network in method.networks.values():
        network.to(device)
