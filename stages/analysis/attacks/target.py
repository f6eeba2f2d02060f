"""What is attacked, what its attacker knows, and what an attack is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.method import Method
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import chosen
from stages.scene.similarity import Similarity
from stages.training.loop import TrainingViews

STANDARD_COLOURS = ("sh_base", "sh_rest")
"""What 3DGS has beside geometry; the attributes of every other method are its own."""


@runtime_checkable
class FollowsFeatures(Protocol):
    """A scene decoder that can be made to forgive a linear change of the features, which are all that its first layer
    sees; see `hiding.decoders.Decoder`."""

    reads_centred: bool

    def read_along(self, back: Float64[Tensor, "M M"]) -> None:
        """Read centred features along r B where it read them along r."""


@runtime_checkable
class ToldDirections(Protocol):
    """A scene decoder that is told from where a pixel is looked at; see `hiding.methods.homogeneous`."""

    def turn_view(self, rotation: Float64[np.ndarray, "3 3"]) -> None:
        """Read of directions in a world that turned what it read of the old ones."""


@runtime_checkable
class ReadsRenders(Protocol):
    """A method whose message decoder looks at the cover's picture itself; see `hiding.methods.decoder`."""

    def read_off(self, picture: Float[Tensor, "H W 3"]) -> Mapping[str, Float[Tensor, "H W 3"]]:
        """The messages in a picture of the cover."""


@dataclass(frozen=True)
class Target:
    """A container as its attacker holds it: Gaussians, and the method with its public networks, without the secret.

    `motion` is how far its world was moved from where it was published: cameras follow. `on_pictures` is what befalls
    the cover's pictures after they are rendered; None: nothing.
    """

    gaussians: Gaussians
    method: Method
    motion: Similarity = field(default_factory=Similarity.identity)
    on_pictures: Callable[[Float[Tensor, "H W 3"]], Float[Tensor, "H W 3"]] | None = None

    @property
    def has_features(self) -> bool:
        """Whether the method is one with coupled features."""
        return FEATURES in self.gaussians.parameters

    @property
    def decoder_follows_features(self) -> bool:
        """Whether the scene decoder can be made to forgive what is done to the features."""
        return self.has_features and isinstance(self.method.networks.get("scene_decoder"), FollowsFeatures)

    @property
    def shows_message_in_renders(self) -> bool:
        """Whether the message is read off the cover's picture."""
        return isinstance(self.method, ReadsRenders)

    @property
    def own_attributes(self) -> dict[str, Tensor]:
        """What a viewer of 3DGS would not know: attributes beside geometry and the cover's harmonics."""
        return {name: values for name, values in self.gaussians.attributes.items() if name not in STANDARD_COLOURS}

    def keeping(self, rows: Int[Tensor, " K"]) -> Target:
        """The same with these Gaussians alone."""
        return replace(self, gaussians=chosen(self.gaussians, rows))

    def with_parameters(self, changed: Mapping[str, Tensor]) -> Target:
        """The same with other values of some parameters; the Gaussians of this one stay as they are."""
        return replace(self, gaussians=Gaussians(self.gaussians.parameters | dict(changed)))


@dataclass(frozen=True)
class Knowledge:
    """What an attacker knows beside the container: the cover's training photos, with their cameras.

    That is more than a thief need have; with renders of the container in their place attacks are weaker. `extent` is
    that of the rig. Attacks that take long call `after_each` now and then: it raises where the work is to stop. Those
    that train do so on `device`; targets are on the CPU.
    """

    views: TrainingViews
    extent: float
    after_each: Callable[[], None] = lambda: None
    device: torch.device | str = "cpu"


Attacker = Callable[[float], Target]
"""From a severity to the attacked target. Severities are asked for in ascending order of the attack's progress."""


@dataclass(frozen=True)
class Attack:
    """`prepare` gives, for a target, a seed and what is known, the target at any severity.

    `severities` are the natural ones of a target, such as bits; None where the damage to the cover sets them, up to
    `strongest`. `fixed` ones are measured besides. `applies`: whether a target has what is attacked. `random`: whether
    the seed changes anything.
    """

    prepare: Callable[[Target, int, Knowledge], Attacker]
    severities: Callable[[Target], Sequence[float]] | None = None
    strongest: float = 1.0
    fixed: tuple[float, ...] = ()
    applies: Callable[[Target], bool] = lambda target: True
    random: bool = True


def seeded(attack: Callable[[Target, float, torch.Generator], Target]) -> Callable[[Target, int, Knowledge], Attacker]:
    """An attack that knows nothing but the container. Every severity begins with the same random numbers: what a
    stronger one does, it does where the weaker one did."""
    return lambda target, seed, _: lambda severity: attack(target, severity, torch.Generator().manual_seed(seed))


def unseeded(attack: Callable[[Target, float], Target]) -> Callable[[Target, int, Knowledge], Attacker]:
    """The same of an attack without chance."""
    return lambda target, _, __: lambda severity: attack(target, severity)
