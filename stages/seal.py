"""`seal`: a container as it is published: without the secret, its messages cannot be read from its Gaussians."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.key import key_apart
from stages.hiding.keystream import MOST_DIMENSIONS
from stages.hiding.left_open import share_left_open
from stages.hiding.method import Method
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.sealing import SEAL, SEALED, SIGNS, Seal, Sealable, can_be_sealed, hash_of, unread_dimensions
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container, write_secret
from stages.scene.attributes import strings

MESSAGES = "messages"


class SealParameters(Parameters):
    """The container's method, and whether to seal it."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    sealed: bool | Literal["where_possible"] = Field(
        "where_possible",
        description="Whether to seal the container. true fails if it cannot be sealed; where_possible, the default, "
        "then leaves it unchanged and says so; false always leaves it unchanged, for comparisons.",
    )


@stage(
    inputs={"container": Input("container"), "secret": Input("secret"), "key": Input("key")},
    outputs={"container": Output("container", privacy="public"), "secret": Output("secret", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
    remarks="stages.hiding.remarks:left_open",
)
def seal(context: Context, parameters: SealParameters) -> None:
    """Encrypt the part of each Gaussian's features that the scene decoder does not read; the secret gets the key.

    The cover does not change. Nothing can be encrypted if the scene decoder reads all of the features, as with every
    method but ours, and with ours if it has no more channels than the decoder reads, or over `MOST_DIMENSIONS` more.
    Nothing needs to be if no message is hidden. `sealed` says what then happens; true raises `UserError`. What the
    scene decoder reads of the messages stays open: `left_open` records how much (`share_left_open`).
    """
    container, secret = context.input("container"), context.input("secret")
    check_method(container, parameters.method)
    gaussians, method = read_gaussians(container), read_method(container, secret)
    facts = {name: value for name, value in secret.attributes.items() if name != MESSAGES}
    hindrance = _hindrance(method)
    if hindrance is not None and parameters.sealed is True:
        raise UserError(
            f"this container cannot be sealed: {hindrance}",
            found=f"method {parameters.method} and sealed: true",
            expected="a message, and a method whose scene decoder does not read all of its features",
            remedy="Set sealed: false, so that nothing calls this container sealed.",
        )
    if isinstance(method, Sealable) and hindrance is None and parameters.sealed:
        made = Seal.made(gaussians, method, key_apart(context.input("key"), "seal"))
        if made.in_the_clear:
            context.log(
                f"{made.in_the_clear} of {len(gaussians)} Gaussians have no room for a seal and stay as they are"
            )
        context.record(left_open=round(share_left_open(gaussians, method), 3))
        gaussians = made.published
        facts |= {SEAL: made.key.hex(), SEALED: hash_of(gaussians), SIGNS: made.signs().hex()}
        facts |= made.expected.facts()
    else:
        context.log(f"left unchanged: {hindrance or 'sealed is false'}")
    write_container(context.output("container"), gaussians, method)
    write_secret(context.output("secret"), method, strings(secret, MESSAGES))
    context.output("secret").attributes |= facts
    context.record(sealed=SEAL in facts, seal_wanted=parameters.sealed is not False)


def _hindrance(method: Method) -> str | None:
    """Why a container of the method cannot be sealed; None if it can be."""
    if not method.messages:
        return "nothing is hidden in it"
    if can_be_sealed(method):
        return None
    if isinstance(method, Sealable) and unread_dimensions(method):
        return f"its features have over {MOST_DIMENSIONS} channels more than the scene decoder reads"
    return "its scene decoder reads all of its features"
