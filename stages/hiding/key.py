"""Keys: randomness that those who have only the container must not be able to reproduce."""

from __future__ import annotations

import hashlib
from typing import Literal, get_args

import numpy as np

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError

KEY_BYTES = 32


def write_key(writer: ArtifactWriter, key: bytes) -> None:
    """Write a `key` artifact of 32 bytes."""
    writer.write("key", np.frombuffer(key, np.uint8))


def key_generator(artifact: Artifact | None, seed: int) -> np.random.Generator:
    """Random numbers seeded with the whole key; without a key, with `seed`, which is not secret.

    Raises `UserError` for a key of another length.
    """
    if artifact is None:
        return np.random.default_rng(seed)
    return np.random.default_rng(int.from_bytes(_bytes_of(artifact), "little"))


def _bytes_of(artifact: Artifact) -> bytes:
    key: bytes = artifact.read("key").tobytes()
    if len(key) != KEY_BYTES:
        raise UserError("a key has the wrong length", found=f"{len(key)} bytes", expected=f"{KEY_BYTES} bytes")
    return key


Use = Literal["view", "weights", "building", "dither"]
"""Uses of a key that have generators of their own, independent of `key_generator`. Their order decides the numbers."""


def generator_apart(artifact: Artifact | None, use: Use, seed: int = 0) -> np.random.Generator:
    """Random numbers from a key, or else `seed`, for one use, independent of `key_generator` and of other uses.

    They are not cryptographically secure: enough of a NumPy generator's output reveals the rest of it.
    """
    uses = get_args(Use)
    return key_generator(artifact, seed).spawn(len(uses))[uses.index(use)]


def key_apart(artifact: Artifact, use: Literal["seal"]) -> bytes:
    """A key for one use, SHA-256 of the use and the whole key, which does not reveal the whole key.

    Raises `UserError` for a key of another length.
    """
    return hashlib.sha256(use.encode() + _bytes_of(artifact)).digest()
