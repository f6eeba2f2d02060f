"""Sealing: encrypting the part of a container's features that its scene decoder does not read.

In homogeneous features, a Gaussian states its share of the cover. Anyone who knows the method can render only Gaussians
with little of it, and sees the messages, in false colours, without their decoder. The scene decoder reads features
along few of their M dimensions. Sealing replaces the rest, which holds the messages, by what looks like random numbers:
the cover does not change, and renders of the rest show noise. The shapes of a message's surfaces remain visible, since
means, sizes, rotations, opacities and shares of the cover do not change.

Each Gaussian's rest is encrypted separately, so that removing some Gaussians does not affect others. The plaintext is
the direction and the length of its difference from what the owner expects (`Expected`). The ciphertext, whose
distribution does not depend on the plaintext (`keystream`), is a direction from an origin that follows from what is
read, and a share of the room in the feature cube along that direction. So the published features say nothing about the
rest beyond what the part that is read, and the Gaussian's position, already say.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.cube import is_cornered, origins_of, room
from stages.hiding.expected import Expected, expectations
from stages.hiding.keystream import MOST_DIMENSIONS, decrypted, encrypted
from stages.hiding.stored_features import FARTHEST, stored
from stages.scene.gaussians import Gaussians

SEAL, SEALED, SIGNS = "seal", "sealed_gaussians", "sealed_signs"
"""Facts of a secret, besides the expectations (`Expected`), in hexadecimal digits: the key of its container's seal, a
hash of the sealed Gaussians (`hash_of`), and the signs of some published rests (`Seal.signs`)."""

SAMPLED = 64
"""Largest number of Gaussians, evenly spread, whose signs a secret holds."""

UNREAD = 1e-3
"""Relative to the largest singular value of the scene decoder's rows: directions with smaller ones count as unread."""


@runtime_checkable
class Sealable(Protocol):
    """A method whose decoders see centred features (activated, less 0.5) only as inner products with a few rows."""

    def rows_read(self) -> Float[Tensor, "R M"]:
        """The scene decoder's rows: changes of features orthogonal to all of them do not change the cover."""
        ...

    def rows_of_messages(self) -> Float[Tensor, "Q M"]:
        """The message decoder's rows, which only the secret has."""
        ...

    def cover_shares(self, gaussians: Gaussians) -> Float[Tensor, " N"]:
        """Each Gaussian's share of the cover, computed from what the scene decoder reads."""
        ...


def can_be_sealed(method: object) -> bool:
    """Whether the scene decoder leaves some dimension of the features unread, and not too many to encrypt them."""
    return isinstance(method, Sealable) and 0 < unread_dimensions(method) <= MOST_DIMENSIONS


def unread_dimensions(method: Sealable) -> int:
    """How many dimensions of the features the scene decoder does not read."""
    return method.rows_read().shape[1] - read_basis(method).shape[1]


def read_basis(method: Sealable) -> Float64[Tensor, "M R"]:
    """Orthonormal columns that span what the scene decoder reads."""
    _, values, rows = torch.linalg.svd(method.rows_read().detach().cpu().double(), full_matrices=False)
    return rows[values > UNREAD * values.max()].T


def hash_of(gaussians: Gaussians) -> str:
    """SHA-256 of the Gaussians' means and opacities, in their order; identifies what was sealed."""
    values = (gaussians[name].detach().cpu().numpy() for name in ("means", "logit_opacities"))
    return hashlib.sha256(b"".join(np.ascontiguousarray(each, "<f4").tobytes() for each in values)).hexdigest()


def key_for(gaussians: Gaussians, method: Sealable, expected: Expected, drawn: bytes) -> bytes:
    """Derive from `drawn` a key for exactly what is encrypted, so that no keystream is used twice.

    That is the difference of these Gaussians, as these decoders read them, from what is `expected`; another version may
    expect something else of the same Gaussians.
    """
    arrays = dict(gaussians.parameters) | {"read": method.rows_read(), "of messages": method.rows_of_messages()}
    digest = hashlib.sha256(drawn)
    for name, values in sorted(arrays.items()):
        array = np.ascontiguousarray(values.detach().cpu().numpy(), "<f4")
        digest.update(f"{name} {array.shape}".encode() + array.tobytes())
    for name, numbers in sorted(expected.facts().items()):
        digest.update(f"{name} {json.dumps(numbers)}".encode())
    return digest.digest()


@dataclass(frozen=True)
class Seal:
    """A sealed container as published, its key, and what its owner expects: all that is needed to open found copies."""

    published: Gaussians
    key: bytes
    expected: Expected
    places: _Places

    @classmethod
    def made(cls, gaussians: Gaussians, method: Sealable, drawn: bytes) -> Seal:
        """Seal Gaussians that are to be published; N = 0 is allowed. The key is for these alone (`key_for`).

        Features are first clamped to the range that can be stored. A Gaussian without room around its origin, whose
        feature is in a corner of the cube, is not encrypted (`in_the_clear`). `method` must be one that
        `can_be_sealed`, and have its messages.
        """
        centred = _centred(gaussians)
        places = _Places.of(_with(gaussians, centred), method)  # from features as stored: opening has no others
        expected = places.expected(centred)
        key = key_for(gaussians, method, expected, drawn)
        return cls(_with(gaussians, places.encrypted(centred, expected, key)), key, expected, places)

    @classmethod
    def of(cls, published: Gaussians, method: Sealable, key: bytes, expected: Expected) -> Seal:
        """The seal of a published container; N = 0 is allowed. `method` must have its messages."""
        return cls(published, key, expected, _Places.of(published, method))

    @property
    def in_the_clear(self) -> int:
        """The number of Gaussians that were not encrypted."""
        return int(is_cornered(self.places.origins).sum())

    def signs(self) -> bytes:
        """Whether each value of some of the published rests is positive, packed into bytes.

        With another key, or with a grain, the same Gaussians have other signs, half of which agree by chance. Noise and
        quantisation leave most of them unchanged.
        """
        numbers = torch.linspace(0, max(0, len(self.published) - 1), min(SAMPLED, len(self.published))).round().long()
        rests = self.places.of_numbers(numbers).rests(_centred(self.published)[numbers])
        return np.packbits((rests > 0).numpy().ravel()).tobytes()

    def opened(self, found: Gaussians, rows: Int[Tensor, " N"]) -> Gaussians:
        """The published Gaussians among F found ones, in their published order, with their features decrypted.

        `rows[i]` is the row in `found` of published Gaussian i, negative if it is missing. Features in corners of the
        cube stay as found. What the scene decoder reads is taken from the published features, not from the found ones:
        changes to it would displace the rest.
        """
        [numbers] = torch.nonzero(rows >= 0, as_tuple=True)
        own = rows[numbers]
        features = self.places.of_numbers(numbers).decrypted(_centred(found)[own], numbers, self.expected, self.key)
        return _with(found.select(own), features)

    def readings(self, gaussians: Gaussians) -> Float64[Tensor, "N R"]:
        """What the scene decoder reads of each Gaussian, which identifies it, since a seal does not change it."""
        return _centred(gaussians) @ self.places.read


@dataclass(frozen=True)
class _Places:
    """What sealing does not change of N Gaussians. All of it refers to centred features.

    `read` holds orthonormal columns that span what the scene decoder reads, `unread` orthonormal columns that span the
    complement, `rows` the message decoder's rows.
    """

    read: Float64[Tensor, "M R"]
    unread: Float64[Tensor, "M U"]
    rows: Float64[Tensor, "Q M"]
    origins: Float64[Tensor, "N M"]
    cover_shares: Float64[Tensor, " N"]

    @classmethod
    def of(cls, gaussians: Gaussians, method: Sealable) -> _Places:
        read = read_basis(method)
        shares = method.cover_shares(gaussians).detach().cpu().double()
        rows = method.rows_of_messages().detach().cpu().double()
        return cls(read, _unread(read), rows, origins_of(_centred(gaussians), read), shares)

    def of_numbers(self, numbers: Int[Tensor, " K"]) -> _Places:
        """The places of a selection of the Gaussians."""
        return replace(self, origins=self.origins[numbers], cover_shares=self.cover_shares[numbers])

    def expected(self, centred: Float64[Tensor, "N M"]) -> Expected:
        """What the owner should expect of these features."""
        return expectations(
            self.cover_shares,
            centred @ self.rows.T,
            lambda expected: (self.rests(centred) - self._expected_rests(expected)).norm(dim=1),
        )

    def encrypted(self, centred: Float64[Tensor, "N M"], expected: Expected, key: bytes) -> Float64[Tensor, "N M"]:
        """Encrypt centred features; those in a corner of the cube stay as they are."""
        differences = self.rests(centred) - self._expected_rests(expected)
        directions = torch.nn.functional.normalize(differences, dim=1)
        turned, room_shares = encrypted(directions, expected.lengths(self.cover_shares, differences.norm(dim=1)), key)
        offsets = turned * (room_shares * self._room(turned))[:, None]
        return torch.where(is_cornered(self.origins)[:, None], centred, self.origins + offsets @ self.unread.T)

    def decrypted(
        self, centred: Float64[Tensor, "N M"], numbers: Int[Tensor, " N"], expected: Expected, key: bytes
    ) -> Float64[Tensor, "N M"]:
        """Decrypt centred features, which may have been altered; those in a corner of the cube stay as they are."""
        rests = self.rests(centred)
        turned = torch.nn.functional.normalize(rests, dim=1)
        space = self._room(turned).clamp_min(torch.finfo(torch.float64).tiny)
        directions, lengths = decrypted(turned, rests.norm(dim=1) / space, numbers, key)
        differences = directions * expected.distances(self.cover_shares, lengths)[:, None]
        own = self.origins + (self._expected_rests(expected) + differences) @ self.unread.T
        return torch.where(is_cornered(self.origins)[:, None], centred, own)

    def rests(self, centred: Float64[Tensor, "N M"]) -> Float64[Tensor, "N U"]:
        """The unread part of features, relative to the origins."""
        return (centred - self.origins) @ self.unread

    def _expected_rests(self, expected: Expected) -> Float64[Tensor, "N U"]:
        """The smallest rests for which the message decoder reads, as closely as possible, what is expected."""
        missing = expected.readings_at(self.cover_shares) - self.origins @ self.rows.T
        weakest = UNREAD * torch.linalg.matrix_norm(self.rows, 2)
        return missing @ torch.linalg.pinv(self.rows @ self.unread, atol=weakest, rtol=0.0).T

    def _room(self, directions: Float64[Tensor, "N U"]) -> Float64[Tensor, " N"]:
        """The distance from each origin to the border of the cube along these unread directions."""
        return room(self.origins, directions @ self.unread.T)


def _unread(read: Float64[Tensor, "M R"]) -> Float64[Tensor, "M U"]:
    """Orthonormal columns that span the complement of `read`: orthogonalised projections of cosines over channels.

    They depend on that space alone. A basis chosen by linear algebra routines would differ between machines.
    """
    channels, count = len(read), len(read) - read.shape[1]
    places, numbers = torch.arange(channels).double() + 0.5, torch.arange(1, count + 1).double()
    waves = torch.cos(torch.pi / channels * places[:, None] * numbers)
    columns, triangle = torch.linalg.qr(waves - read @ (read.T @ waves))
    return columns * triangle.diagonal().sign()


def _centred(gaussians: Gaussians) -> Float64[Tensor, "N M"]:
    return (gaussians[FEATURES].detach().cpu().double().sigmoid() - 0.5).clamp(-FARTHEST, FARTHEST)


def _with(gaussians: Gaussians, centred: Float64[Tensor, "N M"]) -> Gaussians:
    return gaussians.with_parameters({FEATURES: stored(centred + 0.5).to(gaussians.device)})
