"""Sealing: what a container's scene decoder does not read of its features is moved between Gaussians, as a key says.

In homogeneous features a Gaussian says how much of it is the cover's. Whoever knows the method renders those alone that
are not, and sees the messages, in false colours, without their decoder. The scene decoder reads a feature along few of
its M dimensions. The rest, which holds the messages, goes here to another Gaussian, drawn from those about as opaque:
the cover stays as it is, and what is rendered of the rest is noise. Where a message's surfaces stand can still be told:
means, sizes and opacities are not changed.

About as opaque, since whoever prunes what is transparent, which costs no picture anything, would take with it what it
holds of others. Were rests drawn from all, 15 % pruned so would cost the fox's message 0.7 dB instead of nothing.

An activated feature lies in the cube (0, 1)^M, and what is moved has to lie in it with what the scene decoder reads of
its new Gaussian. So not the rest itself is moved, but its direction and how far it reaches of what room there is: from
a point inside the cube that follows from what the scene decoder reads.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.stored_features import FARTHEST, stored
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import chosen

SEAL, SEALED, BANDS = "seal", "sealed_gaussians", "sealed_bands"
"""Facts of a secret: the key of its container's seal and a hash of its Gaussians (`hash_of`), in hexadecimal digits,
and the number of bands of opacity within which rests were exchanged."""

MOST_BANDS, SMALLEST_BAND = 4, 1000
"""How many there are at most, and Gaussians to a band at least: the fewer are in question, the easier it is to find out
whose rest is whose. With two bands a quarter pruned so would cost the fox's message 0.08 dB, with four nothing."""

INSIDE = (0.45, 0.49, 0.499)
"""From 0.5, of each channel: how far points of origin lie at most, so that there is room around them: the first where
there are such points. Where what the scene decoder reads is extreme there may be none that is so far inside."""

ROUNDS = 100
"""Of projections onto what the scene decoder reads and onto the cube: no Gaussian of the fox or kitchen needed more."""

UNREAD = 1e-3
"""Of the largest singular value of what the scene decoder reads along: a direction below that is not read."""


@runtime_checkable
class ReadsAlong(Protocol):
    """A method whose scene decoder reads of a centred feature (activated, less 0.5) its products with a few rows."""

    def rows_read(self) -> Float[Tensor, "R M"]:
        """These rows; what is at right angles to all of them does not change the cover."""
        ...


@dataclass(frozen=True)
class Rest:
    """What the scene decoder does not read of N features: unit directions, and shares in [0, 1] of the room there is.

    `origins` are the points from which both are counted; all are of centred features.
    """

    origins: Float64[Tensor, "N M"]
    directions: Float64[Tensor, "N M"]
    shares: Float64[Tensor, " N"]

    def moved(self, rows: Int[Tensor, " N"]) -> Rest:
        """The rests of other Gaussians, at the same origins."""
        return Rest(self.origins, self.directions[rows], self.shares[rows])

    def features(self) -> Float64[Tensor, "N M"]:
        """Centred features with these rests."""
        reach = self.shares * room(self.origins, self.directions)
        return self.origins + self.directions * reach[:, None]


def can_be_sealed(method: object) -> bool:
    """Whether the scene decoder leaves some dimension of the features unread."""
    return isinstance(method, ReadsAlong) and read_basis(method).shape[1] < method.rows_read().shape[1]


def read_basis(method: ReadsAlong) -> Float64[Tensor, "M R"]:
    """Orthonormal columns that span what the scene decoder reads."""
    _, values, rows = torch.linalg.svd(method.rows_read().detach().cpu().double(), full_matrices=False)
    return rows[values > UNREAD * values.max()].T


def hash_of(gaussians: Gaussians) -> str:
    """Of where the Gaussians are and how opaque, in their order: what a seal goes by."""
    values = (gaussians[name].detach().cpu().numpy() for name in ("means", "logit_opacities"))
    return hashlib.sha256(b"".join(np.ascontiguousarray(each, "<f4").tobytes() for each in values)).hexdigest()


def bands_for(count: int) -> int:
    """The number of bands of a container of so many Gaussians."""
    return max(1, min(MOST_BANDS, count // SMALLEST_BAND))


def sources_of(key: bytes, gaussians: Gaussians, bands: int) -> Int[Tensor, " N"]:
    """For each row the one whose rest goes there: another of the same band, as nobody can tell without the key.

    Bands are of as many Gaussians each, by opacity, the first of those least opaque; of two that are equally opaque the
    first row is in the lower one. Within a band they are sorted by what SHAKE-256 makes of the key and of the hash of
    these Gaussians: who comes to know the order in one container does not know that in another of the same key.
    """
    count = len(gaussians)
    order = np.argsort(gaussians["logit_opacities"].detach().cpu().numpy(), kind="stable")
    band = np.empty(count, dtype=np.int64)
    band[order] = np.arange(count) * bands // max(1, count)
    chance = np.frombuffer(hashlib.shake_256(key + bytes.fromhex(hash_of(gaussians))).digest(8 * count), "<u8")
    sources = np.empty(count, dtype=np.int64)
    sources[np.argsort(band, kind="stable")] = np.lexsort([chance, band])
    return torch.from_numpy(sources)


def sealed(gaussians: Gaussians, method: ReadsAlong, key: bytes, bands: int) -> Gaussians:
    """The container in which each Gaussian has the rest of another (`sources_of`); N = 0 is allowed.

    Features are stored anew, at most `FARTHEST` from 0.5. A Gaussian around whose origin there is no room, its feature
    being at a corner of the cube, stays as it is; what it should have held is lost. `method` has to be one that
    `can_be_sealed`.
    """
    centred = _centred(gaussians)
    rest = rest_of(centred, read_basis(method))
    features = rest.moved(sources_of(key, gaussians, bands)).features()
    return _with(gaussians, torch.where(is_cornered(rest.origins)[:, None], centred, features))


@dataclass(frozen=True)
class Seal:
    """A sealed container as it was published, and its key: what is found of it later is opened by it.

    What follows from both alone is made once. `basis` spans what the scene decoder reads, `origins` are those of the
    published Gaussians, and `holders` the rows of those that hold each one's rest.
    """

    published: Gaussians
    basis: Float64[Tensor, "M R"]
    origins: Float64[Tensor, "N M"]
    holders: Int[Tensor, " N"]

    @classmethod
    def of(cls, published: Gaussians, method: ReadsAlong, key: bytes, bands: int) -> Seal:
        """The seal of `published`, of which N = 0 is allowed."""
        basis = read_basis(method)
        holders = torch.empty(len(published), dtype=torch.long)
        holders[sources_of(key, published, bands)] = torch.arange(len(published))
        return cls(published, basis, rest_of(_centred(published), basis).origins, holders)

    def opened(self, found: Gaussians, rows: Int[Tensor, " N"]) -> Gaussians:
        """Of F Gaussians that were found those that get back their own rest, in the order in which they were sealed.

        `rows`: which of the found ones each published one is, negative for one that is missing. One whose rest is not
        among those found is left out, as nothing tells what it shows of a message. Those at a corner of the cube are as
        they were found. Of what the scene decoder reads nothing is taken from those found: what was done to it would
        come between a rest and where it belongs.
        """
        there, centred = rows >= 0, _centred(found)
        stayed = is_cornered(self.origins)
        whole = there & (stayed | there[self.holders])
        own, holders = rows[whole], self.holders[whole]
        held = rest_from(self.origins[holders], centred[rows[holders]], self.basis)
        back = Rest(self.origins[whole], held.directions, held.shares)
        features = torch.where(stayed[whole][:, None], centred[own], back.features())
        return _with(chosen(found, own), features)

    def told(self, gaussians: Gaussians) -> Float64[Tensor, "N R"]:
        """What the scene decoder reads of each Gaussian, which a seal leaves as it is: it tells which one it is."""
        return _centred(gaussians) @ self.basis


def rest_of(features: Float64[Tensor, "N M"], read: Float64[Tensor, "M R"]) -> Rest:
    """What is not read of centred features; a feature at its origin has the direction 0."""
    features = features.clamp(-FARTHEST, FARTHEST)
    return rest_from(_origins((features @ read) @ read.T, read), features, read)


def rest_from(origins: Float64[Tensor, "N M"], features: Float64[Tensor, "N M"], read: Float64[Tensor, "M R"]) -> Rest:
    """What is not read of centred features, from these origins, which need not be of what is read of them."""
    offsets = features.clamp(-FARTHEST, FARTHEST) - origins
    offsets = offsets - (offsets @ read) @ read.T
    lengths = offsets.norm(dim=1)
    directions = offsets / lengths.clamp_min(torch.finfo(lengths.dtype).tiny)[:, None]
    space = room(origins, directions)
    return Rest(origins, directions, torch.where(space > 0, lengths / space, 0.0).clamp(0, 1))


def is_cornered(origins: Float64[Tensor, "N M"]) -> Bool[Tensor, " N"]:
    """Whether there is no room around an origin."""
    return origins.abs().amax(dim=1) > FARTHEST


def room(origins: Float64[Tensor, "N M"], directions: Float64[Tensor, "N M"]) -> Float64[Tensor, " N"]:
    """How far each origin is from the border of the cube along its direction; 0 outside of it, or without one."""
    ends = torch.where(directions > 0, FARTHEST - origins, FARTHEST + origins) / directions.abs()
    nearest = torch.where(directions == 0, torch.inf, ends).amin(dim=1)
    return torch.where(nearest.isfinite(), nearest, 0.0).clamp_min(0)


def _origins(read: Float64[Tensor, "N M"], basis: Float64[Tensor, "M R"]) -> Float64[Tensor, "N M"]:
    """Points of which the scene decoder reads the same, inside the cube, if there are any."""
    origins = _nearest_inside(read, basis, INSIDE[0])
    for inside in INSIDE[1:]:
        outside = origins.abs().amax(dim=1) > FARTHEST
        origins[outside] = _nearest_inside(read[outside], basis, inside)
    return origins


def _nearest_inside(
    read: Float64[Tensor, "N M"], basis: Float64[Tensor, "M R"], inside: float
) -> Float64[Tensor, "N M"]:
    """By projecting onto the smaller cube and onto what is read, in turn."""
    points = read
    for _ in range(ROUNDS):
        nearer = points.clamp(-inside, inside)
        points = read + nearer - (nearer @ basis) @ basis.T
    return points


def _centred(gaussians: Gaussians) -> Float64[Tensor, "N M"]:
    return gaussians[FEATURES].detach().cpu().double().sigmoid() - 0.5


def _with(gaussians: Gaussians, centred: Float64[Tensor, "N M"]) -> Gaussians:
    return Gaussians(gaussians.parameters | {FEATURES: stored(centred + 0.5).to(gaussians.device)})
