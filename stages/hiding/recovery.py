"""Recovery: what was done to a container as a whole is undone by its owner, who has kept what he published.

A thief may turn and shift the scene, and turn or permute the features with the scene decoder behind them: nobody sees
a difference in the cover, and the secret no longer reads what it was trained on. But the owner is told by the published
container where everything was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.spatial.transform import Rotation
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.stored_features import stored
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import moved
from stages.scene.registration import Registration, register
from stages.scene.similarity import Similarity

PAIRS_A_CHANNEL = 2
"""Fewer pairs of Gaussians than so many times the channels tell no map of features."""

CONCENTRATIONS = 10
SPREADS = 4.0
"""Medians of the distances at which a pair may be from a map that it is to count for."""

SMALLEST_VARIANCE = 1e-12
"""Relative to the largest: combinations of channels that differ less than this tell nothing."""

AS_PUBLISHED = 1e-3
"""Of features: so near to what was published, they are what was published."""

NO_NEARER = 1.25
"""A simple map will do where another would bring features nearer by less than this factor, root mean square: noise,
too, asks for a map, which draws features to their mean."""

MISSING = "missing"

Map = Callable[[Tensor], Tensor]
Fit = Callable[[Tensor, Tensor], Map]


@dataclass(frozen=True)
class Recovery:
    """`gaussians` are the found ones in the published world, with features as they were published.

    `motion` carried the published world to where it was found. `matched` is the share of the found Gaussians that lie
    where published ones do after it is undone; `feature_change` by how much features were changed back, root mean
    square of activated features in [0, 1], of channels that both have: 0 where they were left as they are. `centre` is
    the median of the published means.
    """

    gaussians: Gaussians
    motion: Similarity
    matched: float
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
        return is_motion(self.motion) or self.feature_change > 0


def is_motion(motion: Similarity) -> bool:
    """Whether it is anything but the identity."""
    same = motion.scale == 1 and np.array_equal(motion.rotation, np.eye(3)) and not motion.translation.any()
    return not same


def recovered(found: Gaussians, published: Gaussians, seed: int) -> Recovery | None:
    """A found container's Gaussians with what was done to all of them alike undone, by what was published.

    A motion of the world is found and undone (`register`), with everything that turns in it: shapes, and harmonics
    where the method has some. Then the map is fitted that carries activated features of paired Gaussians to those
    published, and on which most pairs agree: those whose features were changed otherwise do not count. It is a turn if
    that will do, and else affine: what was turned comes back, and what was removed does, as far as other channels tell
    of it. The map has M (M + 1) numbers, so that it cannot carry a message of its own. Found features may have another
    number of channels. Gaussians without a partner stay, and are moved and mapped like the others; where pairs are too
    few to tell a map, or none brings features nearer, they stay as they are.

    None where nothing fits. Works for every method, and N = 0 fits nothing. All values are to be finite. `seed` is that
    of what `register` tries.
    """
    registration = register(found, published, seed)
    if registration is None:
        return None
    gaussians = moved(found, registration.motion.inverse()) if is_motion(registration.motion) else found
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
    return Recovery(gaussians, registration.motion, registration.matched, change, centre)


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
    """Features of all found Gaussians, mapped as those with a partner ask for: turned if that will do, else affinely.

    None where they are to stay as they are, since that will do, or since pairs are too few.
    """
    if len(registration.found) < PAIRS_A_CHANNEL * (features.shape[1] + 1):
        return None
    seen, wanted = features[torch.from_numpy(registration.found)], published[torch.from_numpy(registration.published)]
    affine = _most_agree_on(_affine, seen, wanted, _affine(seen, wanted))
    if seen.shape != wanted.shape:
        return affine(features)
    turned = _most_agree_on(_turned, seen, wanted, affine)
    chosen = _simplest((_left, turned, affine), seen, wanted)
    return chosen(features) if chosen is not _left else None


def _simplest(maps: Sequence[Map], seen: Float64[Tensor, "P M"], wanted: Float64[Tensor, "P M"]) -> Map:
    """The first that brings most features to what was published; or else the first than which none brings all of them
    much nearer."""
    distances = [(each(seen) - wanted).norm(dim=1) for each in maps]
    typical = [float(each.median()) for each in distances]
    overall = [float(each.square().mean().sqrt()) for each in distances]
    exact = [each for each, distance in zip(maps, typical, strict=True) if distance <= AS_PUBLISHED]
    near = [each for each, distance in zip(maps, overall, strict=True) if distance <= NO_NEARER * min(overall)]
    return (exact or near)[0]


def _left(features: Tensor) -> Tensor:
    return features


def _root_mean_square(back: Float64[Tensor, "N M"], features: Float64[Tensor, "N K"]) -> float:
    both = min(back.shape[1], features.shape[1])
    return float((back[:, :both] - features[:, :both]).square().mean().sqrt())


def _most_agree_on(fit: Fit, seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"], start: Map) -> Map:
    """A map by trimmed squares (Rousseeuw 1984): fitted to the half of the pairs that it suits best, `start` at first,
    and in the end to all that it suits about as well."""
    found = start
    for _ in range(CONCENTRATIONS):
        distances = (found(seen) - wanted).norm(dim=1)
        kept = distances <= distances.median()
        found = fit(seen[kept], wanted[kept])
    distances = (found(seen) - wanted).norm(dim=1)
    kept = distances <= SPREADS * distances.median().clamp_min(AS_PUBLISHED)
    return fit(seen[kept], wanted[kept])


def _affine(seen: Float64[Tensor, "P K"], wanted: Float64[Tensor, "P M"]) -> Map:
    """By least squares."""
    start, end = seen.mean(dim=0), wanted.mean(dim=0)
    centred = seen - start
    inverse = torch.linalg.pinv(centred.T @ centred, rtol=SMALLEST_VARIANCE, hermitian=True)
    matrix = inverse @ (centred.T @ (wanted - end))
    return lambda features: (features - start) @ matrix + end


def _turned(seen: Float64[Tensor, "P M"], wanted: Float64[Tensor, "P M"]) -> Map:
    """Turned, mirrored and scaled, by least squares but for the scale, which is that of the spreads: of noisy features,
    least squares would draw the mapped ones together."""
    start, end = seen.mean(dim=0), wanted.mean(dim=0)
    left, _, right = torch.linalg.svd((seen - start).T @ (wanted - end))
    scale = (wanted - end).norm() / (seen - start).norm().clamp_min(AS_PUBLISHED)
    matrix = scale * left @ right
    return lambda features: (features - start) @ matrix + end
