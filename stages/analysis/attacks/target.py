"""Targets of attacks, the attacker's knowledge, and attacks themselves."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method, ReadsRenders, move_networks
from stages.hiding.networks import SCENE_DECODER
from stages.scene.gaussians import Gaussians
from stages.scene.similarity import Similarity
from stages.scene.spherical_harmonics import SH_BASE, SH_REST
from stages.training.loop import TrainingViews

STANDARD_COLOURS = (SH_BASE, SH_REST)
"""The attributes of 3DGS besides geometry; all others belong to a method of their own."""


@runtime_checkable
class FollowsFeatures(Protocol):
    """A scene decoder that can compensate for a linear change of the features; see `hiding.decoders.Decoder`, whose
    first inputs they are. `reads_centred`: whether it reads features minus half the blended opacity."""

    reads_centred: bool

    def read_along(self, back: Float64[Tensor, "M M"]) -> None:
        """Apply rows r B to centred features in place of rows r; B is `back`."""


@runtime_checkable
class ToldDirections(Protocol):
    """A scene decoder that reads viewing directions; see `hiding.methods.homogeneous`."""

    def turn_view(self, rotation: Float64[np.ndarray, "3 3"]) -> None:
        """Read a direction rotated by `rotation` as it read the original direction."""


@dataclass(frozen=True)
class Target:
    """A container as its attacker holds it: Gaussians, and the method with its public networks, without the secret.

    `motion` maps the published world to the present one; cameras follow it. `on_pictures` distorts the cover's pictures
    after rendering; None leaves them as they are.
    """

    gaussians: Gaussians
    method: Method
    motion: Similarity = field(default_factory=Similarity.identity)
    on_pictures: Callable[[Float[Tensor, "H W 3"]], Float[Tensor, "H W 3"]] | None = None

    @property
    def has_features(self) -> bool:
        """Whether the Gaussians have coupled features."""
        return FEATURES in self.gaussians.parameters

    @property
    def decoder_follows_features(self) -> bool:
        """Whether the scene decoder can compensate for a linear change of the features."""
        return self.has_features and isinstance(self.method.networks.get(SCENE_DECODER), FollowsFeatures)

    @property
    def shows_message_in_renders(self) -> bool:
        """Whether the message is read from the cover's picture."""
        return isinstance(self.method, ReadsRenders)

    @property
    def own_attributes(self) -> dict[str, Tensor]:
        """The attributes that 3DGS does not have: all but geometry and the cover's harmonics."""
        return {name: values for name, values in self.gaussians.attributes.items() if name not in STANDARD_COLOURS}

    def on(self, device: torch.device | str) -> Target:
        """The same target on a device, with a copy of its method; Gaussians that are already there are shared."""
        method = copy.deepcopy(self.method)
        move_networks(method, device)
        return replace(self, gaussians=self.gaussians.to(device), method=method)

    def keeping(self, rows: Int[Tensor, " K"]) -> Target:
        """A copy with only the Gaussians in these rows."""
        return replace(self, gaussians=self.gaussians.select(rows))

    def with_parameters(self, changed: Mapping[str, Tensor]) -> Target:
        """A copy with some parameters replaced; this target's own Gaussians stay as they are."""
        return replace(self, gaussians=self.gaussians.with_parameters(changed))


@dataclass(frozen=True)
class Knowledge:
    """What an attacker knows besides the container: the cover's training photos, with their cameras.

    A real thief may know less; attacks that use renders of the container in place of the photos are weaker. `extent` is
    the extent of the camera rig. Long attacks call `after_each` from time to time; it raises if the work is to stop.
    Training and renders of the container run on `device`; targets are on the CPU.
    """

    views: TrainingViews
    extent: float
    after_each: Callable[[], None] = lambda: None
    device: torch.device | str = "cpu"


Attacker = Callable[[float], Target]
"""Maps a severity to the attacked target. For an attack that is a training, severities must not descend."""


@dataclass(frozen=True)
class Attack:
    """One attack, and the severities at which it is measured.

    `severities` gives a target's natural severities, such as bits; if None, they are calibrated by the damage to the
    cover, up to `strongest`, and the `fixed` ones are measured as well. `applies` says whether a target has what is
    attacked, `random` whether the attack depends on the seed.
    """

    prepare: Callable[[Target, int, Knowledge], Attacker]
    severities: Callable[[Target], Sequence[float]] | None = None
    strongest: float = 1.0
    fixed: tuple[float, ...] = ()
    applies: Callable[[Target], bool] = lambda target: True
    random: bool = True


def seeded(attack: Callable[[Target, float, torch.Generator], Target]) -> Callable[[Target, int, Knowledge], Attacker]:
    """Prepare a random attack that needs only the container.

    Every severity starts from the same random state, so that a stronger attack extends a weaker one.
    """
    return lambda target, seed, _: lambda severity: attack(target, severity, torch.Generator().manual_seed(seed))


def unseeded(attack: Callable[[Target, float], Target]) -> Callable[[Target, int, Knowledge], Attacker]:
    """Prepare a deterministic attack that needs only the container."""
    return lambda target, _, __: lambda severity: attack(target, severity)
