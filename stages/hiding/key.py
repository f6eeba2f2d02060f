"""Keys: the randomness that a container's readers must not be able to repeat."""

from __future__ import annotations

import hashlib
from typing import Literal

import numpy as np

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError

KEY_BYTES = 32


def write_key(writer: ArtifactWriter, key: bytes) -> None:
    """Write a `key` artifact of 32 bytes."""
    writer.write("key", np.frombuffer(key, np.uint8))


def key_generator(artifact: Artifact | None, seed: int) -> np.random.Generator:
    """The random numbers that follow from the whole key; without a key, from `seed`, which is no secret.

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


APART = ("view", "weights", "building")
"""What is drawn from a key apart from its first random numbers."""


def generator_apart(artifact: Artifact, use: Literal["view", "weights", "building"]) -> np.random.Generator:
    """Random numbers of a key for one use, independent of those of `key_generator` and of other uses.

    Not as a cipher's are: numpy's generators are no secret to who knows enough of what they drew.
    """
    return key_generator(artifact, 0).spawn(len(APART))[APART.index(use)]


def key_apart(artifact: Artifact, use: Literal["seal"]) -> bytes:
    """A key for one use, from which nothing follows of the whole key: SHA-256 of both.

    Raises `UserError` for a key of another length.
    """
    return hashlib.sha256(use.encode() + _bytes_of(artifact)).digest()
