"""Recovery: what was done to a container as a whole is undone by its owner, who has kept what he published.

A thief may turn, shift and mirror the scene, and turn or permute the features with the scene decoder behind them: the
cover is as good as it was, and the secret no longer reads what it was trained on. But the owner is told by the
published container where everything was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.spatial.transform import Rotation
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.stored_features import stored
from stages.hiding.unmixing import unmixing
from stages.scene.garbage import LARGEST
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import mirrored, moved
from stages.scene.registration import Registration, register
from stages.scene.similarity import Similarity

PAIRS_A_CHANNEL = 3
"""Fewer pairs of Gaussians than so many times the channels tell no map of features. A map is fitted to half of them: of
two pairs a channel it would pass through that half exactly, whatever their features are."""

MISSING = "missing"
"""For the shape of an attribute that is not there."""


@dataclass(frozen=True)
class Recovery:
    """`gaussians` are the found ones in the published world, with features as they were published.

    `motion` carried the published world to where it was found, or, of a `mirrored` one, to where its mirror image
    (`stages/scene/moved_splats.py`) stands. `matched` is the share of the found Gaussians that are published ones,
    `found_again` that of the published ones that are there; `is_certain` where this is enough to say that the one was
    made from the other (`Registration` has all three). `feature_change` is by how much features were changed back, root
    mean square of activated features in [0, 1], of channels that both have: 0 where they were left as they are.
    `centre` is the median of the published means.
    """

    gaussians: Gaussians
    mirrored: bool
    motion: Similarity
    matched: float
    found_again: float
    is_certain: bool
    feature_change: float
    centre: Float[np.ndarray, " 3"]

    @property
    def degrees(self) -> float:
        """Of the turn."""
        return float(np.rad2deg(Rotation.from_matrix(self.motion.rotation).magnitude()))

    @property
    def shift(self) -> float:
        """How far the centre was moved, in units of the published world."""
        return float(np.linalg.norm(self.motion.points(self.centre[None])[0] - self.centre)) / self.motion.scale

    @property
    def changed(self) -> bool:
        """Whether anything was undone; if not, the Gaussians are the found ones, bit for bit."""
        return self.mirrored or is_motion(self.motion) or self.feature_change > 0


def is_motion(motion: Similarity) -> bool:
    """Whether it is anything but the identity."""
    same = motion.scale == 1 and np.array_equal(motion.rotation, np.eye(3)) and not motion.translation.any()
    return not same


def recovered(found: Gaussians, published: Gaussians, seed: int) -> Recovery | None:
    """A found container's Gaussians with what was done to all of them alike undone, by what was published.

    A motion of the world is found and undone (`register`), with everything that turns in it: shapes, and harmonics
    where the method has some. Where places tell of none, the mirror image of what was found is looked at, too, and
    taken if more of what was published is there. Then the map is fitted that carries activated features of paired
    Gaussians to those published (`unmixing`), and all features are mapped: what was turned comes back, and what was
    removed does, as far as other channels tell of it. The map has M (M + 1) numbers, so that it cannot carry a message
    of its own. Found features may have another number of channels. Gaussians without a partner stay, and are moved and
    mapped like the others. Where pairs are too few to tell a map, or none brings features nearer, these stay as they
    are.

    None where nothing fits, or too few Gaussians to tell how features of another number of channels are to be mapped.
    Works for every method; N = 0 fits nothing. All values are to be finite. `seed` is that of what `register` tries.
    """
    seen, registration = _registered(found, published, seed)
    if registration is None:
        return None
    gaussians = seen
    if is_motion(registration.motion):
        gaussians = moved(with_bounded_quaternions(seen), registration.motion.inverse())
    change = 0.0
    if FEATURES in found.parameters:
        features, originals = _activated(found), _activated(published)
        back = _carried_back(features, originals, registration)
        if back is not None:
            change = _root_mean_square(back, features)
            gaussians = Gaussians(gaussians.parameters | {FEATURES: stored(back)})
        elif features.shape[1] != originals.shape[1]:
            return None
    centre = np.median(published.means.detach().double().numpy(), axis=0)
    return Recovery(
        gaussians,
        seen is not found,
        registration.motion,
        registration.matched,
        registration.found_again,
        registration.is_certain,
        change,
        centre,
    )


def _registered(found: Gaussians, published: Gaussians, seed: int) -> tuple[Gaussians, Registration | None]:
    """What was found, as it is or mirrored, whichever has more of what was published, and where it stands."""
    as_found = register(found, published, seed)
    if as_found is not None and as_found.by_place:
        return found, as_found
    image = mirrored(found)
    of_image = register(image, published, seed)
    if of_image is not None and (as_found is None or of_image.found_again > as_found.found_again):
        return image, of_image
    return found, as_found


def with_bounded_quaternions(gaussians: Gaussians) -> Gaussians:
    """The same rotations, by quaternions that are at most as long as `LARGEST` allows.

    A thief may put one in that is as long as float32 can tell: turned, it would be infinite.
    """
    quats = gaussians.quats.detach().double()
    lengths = quats.norm(dim=1, keepdim=True)
    bounded = torch.where(lengths > LARGEST["quats"], quats / lengths, quats)
    return Gaussians(gaussians.parameters | {"quats": bounded.to(gaussians.quats.dtype)})


def unlike(found: Mapping[str, Tensor], published: Mapping[str, Tensor]) -> tuple[str, ...]:
    """The attributes that only one of two containers has, or both in other shapes, features of any number aside."""
    first, second = (
        {name: values.shape[1:] if name != FEATURES else None for name, values in each.items()}
        for each in (found, published)
    )
    names = first.keys() | second.keys()
    return tuple(sorted(name for name in names if first.get(name, MISSING) != second.get(name, MISSING)))


def _activated(gaussians: Gaussians) -> Float64[Tensor, "N M"]:
    return gaussians[FEATURES].detach().double().sigmoid()


def _carried_back(
    features: Float64[Tensor, "N K"], published: Float64[Tensor, "O M"], registration: Registration
) -> Float64[Tensor, "N M"] | None:
    """Features of all found Gaussians, mapped as those with a partner ask for.

    None where they are to stay as they are, since that will do, or since pairs are too few.
    """
    if len(registration.found) < PAIRS_A_CHANNEL * (features.shape[1] + 1):
        return None
    seen, wanted = features[torch.from_numpy(registration.found)], published[torch.from_numpy(registration.published)]
    back = unmixing(seen, wanted)
    return back(features) if back is not None else None


def _root_mean_square(back: Float64[Tensor, "N M"], features: Float64[Tensor, "N K"]) -> float:
    both = min(back.shape[1], features.shape[1])
    return float((back[:, :both] - features[:, :both]).square().mean().sqrt())
