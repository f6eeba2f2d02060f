"""Opening: a sealed container as its secret reads it, also where Gaussians of it are missing or others were added."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.hiding.method import Method
from stages.hiding.sealing import PLACES, SEAL, ReadsAlong, opened, places_of
from stages.scene.attributes import string
from stages.scene.gaussians import Gaussians
from stages.scene.registration import register

ELSEWHERE = -1
"""For the row of a Gaussian that is none of those that were published."""


def is_sealed(secret: Artifact) -> bool:
    """Whether the secret is that of a sealed container."""
    return SEAL in secret.attributes


def open_container(
    gaussians: Gaussians, method: Method, secret: Artifact, published: Gaussians | None = None, seed: int = 0
) -> Gaussians:
    """The Gaussians with the messages where they were hidden; as they are, if their secret is of no seal.

    Without `published` they must be those that were sealed, at their places. With it they may be some of these and
    others, each a little moved, as `recover` gives them: they are paired by places (`register`, whose `seed` it is).
    Others are left out, and those whose share of a message is not there (`opened`).

    Raises `UserError` where they are not those that were sealed, and for a seal that is none of this method.
    """
    if not is_sealed(secret):
        return gaussians
    key = _key_of(secret)
    if not isinstance(method, ReadsAlong):
        raise _broken(secret, f"the seal of a container of {method.name}")
    if published is not None:
        return opened(gaussians, method, key, rows_of(gaussians, published, seed), len(published))
    if places_of(gaussians) != string(secret, PLACES):
        raise UserError(
            "the container is not as it was sealed: which Gaussian holds what of the messages cannot be told",
            found=f"{len(gaussians)} Gaussians, some of them missing, added or moved",
            expected="the container for which the secret was made",
            remedy="Give `published`, the container as it was published, as workflows/recover_container.yaml does.",
        )
    return opened(gaussians, method, key, torch.arange(len(gaussians)), len(gaussians))


def rows_of(gaussians: Gaussians, published: Gaussians, seed: int) -> Int[Tensor, " F"]:
    """Which published Gaussian each is, by places; `ELSEWHERE` for one that is none, or where places tell nothing."""
    rows = torch.full((len(gaussians),), ELSEWHERE, dtype=torch.long)
    pairs = register(gaussians, published, seed)
    if pairs is not None:
        rows[torch.from_numpy(np.asarray(pairs.found))] = torch.from_numpy(np.asarray(pairs.published))
    return rows


def _key_of(secret: Artifact) -> bytes:
    try:
        return bytes.fromhex(string(secret, SEAL))
    except ValueError as error:
        raise _broken(secret, "a key that is no hexadecimal number") from error


def _broken(secret: Artifact, found: str) -> UserError:
    return UserError(
        "the seal in the secret cannot be used",
        where=str(secret.path),
        found=found,
        expected="the secret of a container that `seal` made",
        remedy="Export the secret once more, and give both folders of one container.",
    )
