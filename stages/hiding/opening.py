"""Opening: decrypting a sealed container with its secret, even if Gaussians are missing or others were added."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from stages.hiding.expected import Expected
from stages.hiding.method import Method, move_networks
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER, Rendering
from stages.hiding.sealing import SEAL, SEALED, SIGNS, Seal, Sealable, can_be_sealed, hash_of
from stages.hiding.storage import read_gaussians, read_method
from stages.scene.attributes import string
from stages.scene.cameras import Cameras
from stages.scene.gaussians import Gaussians
from stages.scene.identification import identified

SAME_SEAL = 0.75
"""Smallest share of agreeing signs (`Seal.signs`) for a container to count as the one that its secret was made for,
after whatever rounding and noise."""

SEED = 0
"""Seed of `register` inside `identified`; fixed, since nothing asks for a seed when a container is opened."""


def is_sealed(secret: Artifact) -> bool:
    """Whether the secret belongs to a sealed container."""
    return SEAL in secret.attributes


@dataclass(frozen=True)
class ReadContainer:
    """A container on a device. `public` are its Gaussians as everybody has them; `gaussians` are those that the secret
    opened, or the same object where there is nothing to open.
    """

    gaussians: Gaussians
    method: Method
    public: Gaussians

    def photographs(self, cameras: Cameras, messages: Collection[str] | None = None) -> Iterator[Rendering]:
        """Yield a rendering for every camera: the cover from `public`, `messages` (by default all) from `gaussians`.

        Rendered from opened Gaussians, the cover's picture, which may be published, would depend on the message: by
        rounding in an honest container, visibly in one that was made for that purpose.
        """
        messages = self.method.messages if messages is None else messages
        if self.public is self.gaussians or not messages:
            yield from photographs(self.public, self.method, cameras, (COVER, *messages))
            return
        covers = photographs(self.public, self.method, cameras, (COVER,))
        opened = photographs(self.gaussians, self.method, cameras, messages)
        for cover, rendering in zip(covers, opened, strict=True):
            shown = {name: rendering.pictures[name] for name in messages}
            yield replace(rendering, pictures={COVER: cover.pictures[COVER], **shown})


def read_container(
    container: Artifact,
    secret: Artifact | None,
    device: torch.device | str = "cpu",
    published: Artifact | None = None,
) -> ReadContainer:
    """Read a container onto a device: opened with its secret, or without a secret as it was published.

    `published`: as in `open_container`. Raises `UserError` like `open_container` and `read_method`.
    """
    gaussians, method = read_gaussians(container), read_method(container, secret)
    opened = gaussians
    if secret is not None and is_sealed(secret):  # on the CPU, whatever the device: it is where seals are made
        originals = read_gaussians(published) if published is not None else None
        opened = open_container(gaussians, method, secret, originals)
    move_networks(method, device)
    public = gaussians.to(device)
    return ReadContainer(public if opened is gaussians else opened.to(device), method, public)


def refuse_sealed(secret: Artifact | None, stage: str) -> None:
    """Raise `UserError` if `stage`, which works on containers before they are sealed, is given a sealed one."""
    if secret is not None and is_sealed(secret):
        raise UserError(
            f"{stage} was given a sealed container",
            where=str(secret.path),
            found="a secret with a seal",
            expected="a container and its secret before they are sealed",
            remedy=f"give {stage} hide.container and hide.secret, and seal what comes out of it",
        )


def open_container(
    gaussians: Gaussians, method: Method, secret: Artifact, published: Gaussians | None = None
) -> Gaussians:
    """Decrypt the Gaussians' features; returns the Gaussians unchanged if the secret has no seal.

    Without `published`, the Gaussians must be those that were sealed, with unchanged means and opacities. With it, they
    may be some of those and others, in any order and each changed a little, as `recover` returns them; Gaussians that
    `identified` does not recognise are left out.

    Raises `UserError` if the container is not the one that was sealed (by positions, opacities, and the signs of some
    features), if none of its Gaussians is recognised, and if the seal does not fit the method. Features that a stranger
    altered are decrypted like others, to something else: `import_container` tells this of files.
    """
    if not is_sealed(secret):
        return gaussians
    originals = gaussians if published is None else published
    _refuse_changed(originals, secret)
    seal = _seal_of(secret, method, originals)
    _refuse_another_seal(seal, secret)
    if published is None:
        return seal.opened(gaussians, torch.arange(len(gaussians)))
    opened = _opened(gaussians, seal)
    if opened is None:
        raise UserError(
            "a sealed container cannot be opened: none of its Gaussians is known",
            found=f"{len(gaussians)} Gaussians, none of them one of the {len(published)} published",
            expected="the published container, moved back as `recover` does, and some of its Gaussians",
            remedy="Give what `recover` makes of the found container, as workflows/recover_container.yaml does.",
        )
    return opened


def opener(method: Method, secret: Artifact, published: Gaussians) -> Callable[[Gaussians], Gaussians]:
    """`open_container` for many found containers; leaves a container sealed if none of its Gaussians is recognised.

    This serves to measure the effect of changes of any strength. Raises `UserError` if the seal does not fit the
    method.
    """
    if not is_sealed(secret):
        return lambda gaussians: gaussians
    seal = _seal_of(secret, method, published)

    def opened(gaussians: Gaussians) -> Gaussians:
        known = _opened(gaussians, seal)
        return gaussians if known is None else known

    return opened


def _opened(gaussians: Gaussians, seal: Seal) -> Gaussians | None:
    """Open the recognised Gaussians; None if there are none."""
    rows = rows_of(gaussians, seal)
    return seal.opened(gaussians, rows) if (rows >= 0).any() else None


def _refuse_changed(gaussians: Gaussians, secret: Artifact) -> None:
    if hash_of(gaussians) != string(secret, SEALED):
        raise UserError(
            "the secret belongs to another container, or this container was changed after sealing",
            found=f"{len(gaussians)} Gaussians; those sealed were different ones, or had other positions or opacities",
            expected="the container for which the secret was made, as it was published",
            remedy="Give the secret that was exported with this container. If it was changed since then, "
            "workflows/recover_container.yaml opens it beside the one that was published.",
        )


def _refuse_another_seal(seal: Seal, secret: Artifact) -> None:
    """Refuse Gaussians that were sealed with another key or with other features: a seal depends on all of them."""
    agreeing = _agreeing(seal, secret) if SIGNS in secret.attributes else 1.0  # the first seals' secrets have none
    if agreeing < SAME_SEAL:
        raise UserError(
            "the secret belongs to another sealing of the same Gaussians",
            where=str(secret.path),
            found=f"{100 * agreeing:.0f} % of the values checked match the sealing; chance gives 50 %",
            expected=f"{100 * SAME_SEAL:.0f} % or more",
            remedy="Give the secret that was exported with this container: a container with a grain has another one.",
        )


def _agreeing(seal: Seal, secret: Artifact) -> float:
    """The share of signs that agree with the secret; 1 without Gaussians."""
    signs = np.frombuffer(seal.signs(), np.uint8)
    try:
        kept = np.frombuffer(bytes.fromhex(string(secret, SIGNS)), np.uint8)
    except ValueError as error:
        raise _broken(secret, "signs that are no hexadecimal number") from error
    if len(kept) != len(signs):
        raise _broken(secret, f"signs of {len(kept)} bytes, where these Gaussians have {len(signs)}")
    return 1 - float(np.unpackbits(kept ^ signs).mean()) if len(signs) else 1.0


def rows_of(gaussians: Gaussians, seal: Seal) -> Int[Tensor, " N"]:
    """For each published Gaussian, its row in `gaussians` as found by `identified`; negative if it is missing."""
    readings = seal.readings(gaussians).numpy(), seal.readings(seal.published).numpy()
    return torch.from_numpy(identified(gaussians, seal.published, SEED, [readings]))


def _seal_of(secret: Artifact, method: Method, published: Gaussians) -> Seal:
    try:
        key = bytes.fromhex(string(secret, SEAL))
    except ValueError as error:
        raise _broken(secret, "a key that is no hexadecimal number") from error
    if not isinstance(method, Sealable):
        raise _broken(secret, f"the seal of a container of {method.name}")
    if not can_be_sealed(method):
        raise _broken(secret, "the seal of a container that cannot be sealed")
    try:
        expected = Expected.from_facts(secret.attributes, len(method.rows_of_messages()))
    except ValueError as error:
        raise _broken(secret, f"{error}; seals had none before this version, which cannot open them") from error
    return Seal.of(published, method, key, expected)


def _broken(secret: Artifact, found: str) -> UserError:
    return UserError(
        "the seal in the secret cannot be used",
        where=str(secret.path),
        found=found,
        expected="the secret of a container that `seal` made",
        remedy="Export the secret once more, and give both folders of one container.",
    )
