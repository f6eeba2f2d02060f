"""Recovery: undoing what was done to a container as a whole, by the owner, who has kept the published one.

A thief may rotate, shift and mirror the scene, and rotate or permute the features together with the scene decoder: the
cover looks as before, but the secret no longer reads what it was trained on. The published container tells the owner
where everything was.
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
from stages.scene.registration import Registration, register, register_scattered
from stages.scene.similarity import Similarity

PAIRS_A_CHANNEL = 3
"""With fewer pairs of Gaussians per channel than this, no map of features is fitted. A map is fitted to half of the
pairs: with two pairs per channel it would fit that half exactly, whatever their features are."""

MISSING = "missing"
"""Stands for the shape of a missing attribute."""


@dataclass(frozen=True)
class Recovery:
    """`gaussians` are the found ones in the published world, with features as published.

    `motion` maps the published world to where it was found or, if `mirrored`, to where the mirror image of what was
    found is (`stages/scene/moved_splats.py`). `matched` is the share of the found Gaussians that are published ones,
    `found_again` the share of the published ones that were found; `is_certain` says whether that suffices to conclude
    that one was made from the other (`Registration` has all three). `feature_change` is by how much features were
    changed back: the root mean square over activated features in [0, 1] and the channels that both have; 0 if they were
    left unchanged. `centre` is the median of the published means.
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
        """The angle of the motion's rotation, in degrees."""
        return float(np.rad2deg(Rotation.from_matrix(self.motion.rotation).magnitude()))

    @property
    def shift(self) -> float:
        """How far the centre was moved, in units of the published world."""
        return float(np.linalg.norm(self.motion.points(self.centre[None])[0] - self.centre)) / self.motion.scale

    @property
    def changed(self) -> bool:
        """Whether anything was undone; if not, the Gaussians equal the found ones bit for bit."""
        return self.mirrored or is_motion(self.motion) or self.feature_change > 0


class TooFewPairs(ValueError):
    """The Gaussians are known, but too few of them to map features with another number of channels."""

    def __init__(self, registration: Registration, channels: int, published: int):
        self.pairs, self.needed = len(registration.found), _pairs_needed(channels)
        self.is_certain, self.channels, self.published = registration.is_certain, channels, published
        super().__init__(f"{self.pairs} pairs; {channels} channels take {self.needed}")


def is_motion(motion: Similarity) -> bool:
    """Whether the similarity differs from the identity."""
    same = motion.scale == 1 and np.array_equal(motion.rotation, np.eye(3)) and not motion.translation.any()
    return not same


def recovered(found: Gaussians, published: Gaussians, seed: int) -> Recovery | None:
    """The Gaussians of a found container, with everything undone that was done to all of them alike.

    First, a motion of the world is found and undone (`register`), including its effect on shapes and on spherical
    harmonics, if the method has some. If positions do not determine the motion, the mirror image of the container is
    tried, too, and used if it contains more of what was published; if there is no motion of the whole at all, shapes
    alone pair Gaussians (`register_scattered`). Then an affine map is fitted that carries the
    activated features of paired Gaussians to the published ones (`unmixing`), and applied to all features. This
    restores what was rotated, and what was removed as far as other channels determine it. The map has M (M + 1)
    numbers, too few to carry a message of its own. Found features may have another number of channels. Gaussians
    without a partner are moved and mapped like the others. If there are too few pairs for a map, or no map brings the
    features nearer, features stay unchanged.

    None if nothing fits. Raises `TooFewPairs` if features with another number of channels cannot be mapped. Works for
    every method; N = 0 fits nothing. All values must be finite. `seed` is passed to `register`.
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
            gaussians = gaussians.with_parameters({FEATURES: stored(back)})
        elif features.shape[1] != originals.shape[1]:
            raise TooFewPairs(registration, features.shape[1], originals.shape[1])
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
    """The found Gaussians or their mirror image, whichever holds more of what was published, and its registration."""
    as_found = register(found, published, seed)
    if as_found is not None and as_found.by_place:
        return found, as_found
    image = mirrored(found)
    of_image = register(image, published, seed)
    if of_image is not None and (as_found is None or of_image.found_again > as_found.found_again):
        return image, of_image
    if as_found is None:
        return found, register_scattered(found, published, seed)
    return found, as_found


def with_bounded_quaternions(gaussians: Gaussians) -> Gaussians:
    """The same rotations, with quaternions at most as long as `LARGEST` allows.

    A thief may insert one of the largest length that float32 can represent; rotating it would give infinity.
    """
    quats = gaussians.quats.detach().double()
    lengths = quats.norm(dim=1, keepdim=True)
    bounded = torch.where(lengths > LARGEST["quats"], quats / lengths, quats)
    return gaussians.with_parameters({"quats": bounded.to(gaussians.quats.dtype)})


def unlike(found: Mapping[str, Tensor], published: Mapping[str, Tensor]) -> tuple[str, ...]:
    """The attributes that only one of two containers has, or that differ in shape; features may differ in channels."""
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
    """The features of all found Gaussians, mapped by what fits those with a partner.

    None if features should stay unchanged: no map is needed, or there are too few pairs.
    """
    if len(registration.found) < _pairs_needed(features.shape[1]):
        return None
    seen, wanted = features[torch.from_numpy(registration.found)], published[torch.from_numpy(registration.published)]
    back = unmixing(seen, wanted)
    return back(features) if back is not None else None


def _pairs_needed(channels: int) -> int:
    return PAIRS_A_CHANNEL * (channels + 1)


def _root_mean_square(back: Float64[Tensor, "N M"], features: Float64[Tensor, "N K"]) -> float:
    both = min(back.shape[1], features.shape[1])
    return float((back[:, :both] - features[:, :both]).square().mean().sqrt())
