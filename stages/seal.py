"""`seal`: a container as it is published: without the secret, its messages cannot be read from its Gaussians."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.key import key_apart
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.sealing import SEAL, SEALED, SIGNS, Seal, Sealable, can_be_sealed, hash_of
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container, write_secret
from stages.scene.attributes import strings

MESSAGES = "messages"


class SealParameters(Parameters):
    """The container's method, and whether to seal it."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    sealed: bool = Field(True, description="Whether to seal the container; false leaves it unchanged, for comparisons.")


@stage(
    inputs={"container": Input("container"), "secret": Input("secret"), "key": Input("key")},
    outputs={"container": Output("container", privacy="public"), "secret": Output("secret", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def seal(context: Context, parameters: SealParameters) -> None:
    """Encrypt the part of each Gaussian's features that the scene decoder does not read; the secret gets the key.

    The cover does not change. A container that hides nothing is left as it is. So is one whose scene decoder reads all
    of its features, since it cannot be sealed: one of another method than ours, or of ours with no more channels than
    the decoder reads.
    """
    container, secret = context.input("container"), context.input("secret")
    check_method(container, parameters.method)
    gaussians, method = read_gaussians(container), read_method(container, secret)
    facts = {name: value for name, value in secret.attributes.items() if name != MESSAGES}
    if not method.messages or not parameters.sealed:
        context.log("left unchanged: " + ("sealed is false" if method.messages else "nothing is hidden in it"))
    elif isinstance(method, Sealable) and can_be_sealed(method):
        made = Seal.made(gaussians, method, key_apart(context.input("key"), "seal"))
        if made.in_the_clear:
            context.log(
                f"{made.in_the_clear} of {len(gaussians)} Gaussians have no room for a seal and stay as they are"
            )
        gaussians = made.published
        facts |= {SEAL: made.key.hex(), SEALED: hash_of(gaussians), SIGNS: made.signs().hex()}
        facts |= made.expected.facts()
    else:
        context.log(
            "left unchanged: its scene decoder reads all of its features, so anyone with the container may be able to "
            "see messages without the secret"
        )
    write_container(context.output("container"), gaussians, method)
    write_secret(context.output("secret"), method, strings(secret, MESSAGES))
    context.output("secret").attributes |= facts
    context.record(sealed=SEAL in facts)
