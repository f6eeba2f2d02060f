"""Keys: the randomness that a container's readers must not be able to repeat."""

from __future__ import annotations

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
    key = artifact.read("key").tobytes()
    if len(key) != KEY_BYTES:
        raise UserError("a key has the wrong length", found=f"{len(key)} bytes", expected=f"{KEY_BYTES} bytes")
    return np.random.default_rng(int.from_bytes(key, "little"))


APART = ("view", "weights", "building", "seal")
"""What is drawn from a key apart from its first random numbers: who learns one knows nothing of another."""


def generator_apart(artifact: Artifact, use: Literal["view", "weights", "building", "seal"]) -> np.random.Generator:
    """Random numbers of a key for one use, independent of those of `key_generator` and of other uses."""
    return key_generator(artifact, 0).spawn(len(APART))[APART.index(use)]
