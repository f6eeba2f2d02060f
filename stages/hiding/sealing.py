"""Sealing: what a container's scene decoder does not read of its features is encrypted, as a key says.

In homogeneous features a Gaussian says how much of it is the cover's. Whoever knows the method renders those alone that
are not, and sees the messages, in false colours, without their decoder. The scene decoder reads a feature along few of
its M dimensions. The rest, which holds the messages, becomes here what chance alone might have drawn: the cover stays
as it is, and what is rendered of the rest is noise. Where a message's surfaces stand can still be told: means, sizes,
rotations and opacities are not changed, nor how much of a Gaussian is the cover's.

The rest of each Gaussian is encrypted by itself, so that whoever takes some away takes nothing from others: not as it
is, but as the direction and the distance by which it differs from what the owner expects (`Expected`). What comes out,
as likely whatever went in (`keystream`), is a direction from an origin that what is read tells, and a share of the
room that there is in the cube of features. So what is published says nothing of a rest that what is read, and where the
Gaussian stands, do not say.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from stages.hiding.coupled import FEATURES
from stages.hiding.cube import is_cornered, origins_of, room
from stages.hiding.expected import Expected, expectations
from stages.hiding.keystream import decrypted, encrypted
from stages.hiding.stored_features import FARTHEST, stored
from stages.scene.gaussians import Gaussians
from stages.scene.moved_splats import chosen

SEAL, SEALED, SIGNS = "seal", "sealed_gaussians", "sealed_signs"
"""Facts of a secret, beside what its owner expects (`Expected`): the key of its container's seal, a hash of its
Gaussians (`hash_of`), and how some of them were published (`Seal.signs`), in hexadecimal digits."""

SAMPLED = 64
"""Gaussians at most, evenly spread, of which a secret holds the signs."""

UNREAD = 1e-3
"""Of the largest singular value of what the scene decoder reads along: a direction below that is not read."""


@runtime_checkable
class Sealable(Protocol):
    """A method whose decoders read of a centred feature (activated, less 0.5) their products with a few rows."""

    def rows_read(self) -> Float[Tensor, "R M"]:
        """Those of the scene decoder: what is at right angles to all of them does not change the cover."""
        ...

    def rows_of_messages(self) -> Float[Tensor, "Q M"]:
        """Those of the message decoder, which only the secret has."""
        ...

    def cover_shares(self, gaussians: Gaussians) -> Float[Tensor, " N"]:
        """How much of each Gaussian is the cover's, by what the scene decoder reads."""
        ...


def can_be_sealed(method: object) -> bool:
    """Whether the scene decoder leaves some dimension of the features unread."""
    return isinstance(method, Sealable) and read_basis(method).shape[1] < method.rows_read().shape[1]


def read_basis(method: Sealable) -> Float64[Tensor, "M R"]:
    """Orthonormal columns that span what the scene decoder reads."""
    _, values, rows = torch.linalg.svd(method.rows_read().detach().cpu().double(), full_matrices=False)
    return rows[values > UNREAD * values.max()].T


def hash_of(gaussians: Gaussians) -> str:
    """Of where the Gaussians are and how opaque, in their order: what a seal goes by."""
    values = (gaussians[name].detach().cpu().numpy() for name in ("means", "logit_opacities"))
    return hashlib.sha256(b"".join(np.ascontiguousarray(each, "<f4").tobytes() for each in values)).hexdigest()


def key_for(gaussians: Gaussians, method: Sealable, drawn: bytes) -> bytes:
    """From what was drawn, the key for these Gaussians and decoders alone: all others have other pads."""
    arrays = dict(gaussians.parameters) | {"read": method.rows_read(), "of messages": method.rows_of_messages()}
    digest = hashlib.sha256(drawn)
    for name, values in sorted(arrays.items()):
        array = np.ascontiguousarray(values.detach().cpu().numpy(), "<f4")
        digest.update(f"{name} {array.shape}".encode() + array.tobytes())
    return digest.digest()


@dataclass(frozen=True)
class Seal:
    """A sealed container as it is published, its key, and what its owner expects: what is found of it is opened so."""

    published: Gaussians
    key: bytes
    expected: Expected
    places: _Places

    @classmethod
    def made(cls, gaussians: Gaussians, method: Sealable, drawn: bytes) -> Seal:
        """The seal of Gaussians that are to be published; N = 0 is allowed. Its key is for these alone (`key_for`).

        Features are stored anew, as far from 0.5 as can be stored. A Gaussian around whose origin there is no room, its
        feature being at a corner of the cube, stays as it is (`in_the_clear`). `method` has to be one that
        `can_be_sealed`, with its messages.
        """
        centred, key = _centred(gaussians), key_for(gaussians, method, drawn)
        places = _Places.of(_with(gaussians, centred), method)  # of what can be stored, which is all that opens it
        expected = places.expected(centred)
        return cls(_with(gaussians, places.encrypted(centred, expected, key)), key, expected, places)

    @classmethod
    def of(cls, published: Gaussians, method: Sealable, key: bytes, expected: Expected) -> Seal:
        """That of a container which was published; N = 0 is allowed. `method` with its messages."""
        return cls(published, key, expected, _Places.of(published, method))

    @property
    def in_the_clear(self) -> int:
        """Gaussians that stayed as they are."""
        return int(is_cornered(self.places.origins).sum())

    def signs(self) -> bytes:
        """Of some of the published rests, whether each of their values is positive, eight in a byte.

        The same Gaussians under another key, or with a grain, have others: half of the signs agree by chance. Noise and
        few bits leave most.
        """
        numbers = torch.linspace(0, max(0, len(self.published) - 1), min(SAMPLED, len(self.published))).round().long()
        rests = self.places.of_numbers(numbers).rests(_centred(self.published)[numbers])
        return np.packbits((rests > 0).numpy().ravel()).tobytes()

    def opened(self, found: Gaussians, rows: Int[Tensor, " N"]) -> Gaussians:
        """Of F Gaussians that were found those that were published, in that order, with what they hold of messages.

        `rows`: which of the found ones each published one is, negative for one that is missing. Those at a corner of
        the cube are as they were found. Of what the scene decoder reads nothing is taken from those found: what was
        done to it would come between a rest and where it belongs.
        """
        [numbers] = torch.nonzero(rows >= 0, as_tuple=True)
        own = rows[numbers]
        features = self.places.of_numbers(numbers).decrypted(_centred(found)[own], numbers, self.expected, self.key)
        return _with(chosen(found, own), features)

    def told(self, gaussians: Gaussians) -> Float64[Tensor, "N R"]:
        """What the scene decoder reads of each Gaussian, which a seal leaves as it is: it tells which one it is."""
        return _centred(gaussians) @ self.places.read


@dataclass(frozen=True)
class _Places:
    """What of N Gaussians is the same under a seal and without it.

    `read` are orthonormal columns that span what the scene decoder reads, `unread` such of all else, `rows` those of
    the message decoder. All is of centred features.
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
        """Those of some of the Gaussians."""
        return replace(self, origins=self.origins[numbers], cover_shares=self.cover_shares[numbers])

    def expected(self, centred: Float64[Tensor, "N M"]) -> Expected:
        """What of these features is to be expected."""
        return expectations(
            self.cover_shares,
            centred @ self.rows.T,
            lambda expected: (self.rests(centred) - self._expected_rests(expected)).norm(dim=1),
        )

    def encrypted(self, centred: Float64[Tensor, "N M"], expected: Expected, key: bytes) -> Float64[Tensor, "N M"]:
        """Centred features; those at a corner of the cube as they are."""
        differences = self.rests(centred) - self._expected_rests(expected)
        directions = torch.nn.functional.normalize(differences, dim=1)
        turned, shares = encrypted(directions, expected.lengths(self.cover_shares, differences.norm(dim=1)), key)
        offsets = turned * (shares * self._room(turned))[:, None]
        return torch.where(is_cornered(self.origins)[:, None], centred, self.origins + offsets @ self.unread.T)

    def decrypted(
        self, centred: Float64[Tensor, "N M"], numbers: Int[Tensor, " N"], expected: Expected, key: bytes
    ) -> Float64[Tensor, "N M"]:
        """Of such features, whatever was done to them, those that were sealed."""
        rests = self.rests(centred)
        turned = torch.nn.functional.normalize(rests, dim=1)
        space = self._room(turned).clamp_min(torch.finfo(torch.float64).tiny)
        directions, lengths = decrypted(turned, rests.norm(dim=1) / space, numbers, key)
        differences = directions * expected.distances(self.cover_shares, lengths)[:, None]
        own = self.origins + (self._expected_rests(expected) + differences) @ self.unread.T
        return torch.where(is_cornered(self.origins)[:, None], centred, own)

    def rests(self, centred: Float64[Tensor, "N M"]) -> Float64[Tensor, "N U"]:
        """What is not read of features, from the origins."""
        return (centred - self.origins) @ self.unread

    def _expected_rests(self, expected: Expected) -> Float64[Tensor, "N U"]:
        """The nearest to the origins of which the message decoder reads, as nearly as can be, what is expected."""
        missing = expected.readings_at(self.cover_shares) - self.origins @ self.rows.T
        weakest = UNREAD * torch.linalg.matrix_norm(self.rows, 2)
        return missing @ torch.linalg.pinv(self.rows @ self.unread, atol=weakest, rtol=0.0).T

    def _room(self, directions: Float64[Tensor, "N U"]) -> Float64[Tensor, " N"]:
        """How far one may go from the origins in these directions."""
        return room(self.origins, directions @ self.unread.T)


def _unread(read: Float64[Tensor, "M R"]) -> Float64[Tensor, "M U"]:
    """Orthonormal columns that span all that is not read: of the first waves over the channels what is not, in turn.

    They follow from that space alone. Which ones linear algebra finds by itself differs between machines.
    """
    channels, count = len(read), len(read) - read.shape[1]
    places, numbers = torch.arange(channels).double() + 0.5, torch.arange(1, count + 1).double()
    waves = torch.cos(torch.pi / channels * places[:, None] * numbers)
    columns, triangle = torch.linalg.qr(waves - read @ (read.T @ waves))
    return columns * triangle.diagonal().sign()


def _centred(gaussians: Gaussians) -> Float64[Tensor, "N M"]:
    return (gaussians[FEATURES].detach().cpu().double().sigmoid() - 0.5).clamp(-FARTHEST, FARTHEST)


def _with(gaussians: Gaussians, centred: Float64[Tensor, "N M"]) -> Gaussians:
    return Gaussians(gaussians.parameters | {FEATURES: stored(centred + 0.5).to(gaussians.device)})
