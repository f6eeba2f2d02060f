"""`unseal`: a sealed container as its secret reads it. It is for whoever has the secret, and not to be published."""

from __future__ import annotations

from pydantic import Field

from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.opening import is_sealed, open_container
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container


class UnsealParameters(Parameters):
    """Whose container it is."""

    method: MethodName = Field("gs_hider", description="The container's method.")
    seed: int = Field(0, ge=0, description="Of what is tried where Gaussians are paired with the published ones.")


@stage(
    inputs={
        "container": Input("container"),
        "secret": Input("secret"),
        "published": Input("container", optional=True),
    },
    outputs={"container": Output("container", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def unseal(context: Context, parameters: UnsealParameters) -> None:
    """Give each Gaussian back what `seal` moved to another; a container that was not sealed is left as it is.

    `published` is the container as it was published, for one that was pruned, added to or moved a little since
    (`recover` gives such): Gaussians that are not among the published ones are left out then, and those whose part of
    the messages was pruned with another.
    """
    container, secret = context.input("container"), context.input("secret")
    check_method(container, parameters.method)
    gaussians, method = read_gaussians(container), read_method(container, secret)
    published = context.input_optional("published")
    found = open_container(
        gaussians, method, secret, None if published is None else read_gaussians(published), parameters.seed
    )
    if len(found) < len(gaussians):
        context.log(f"{len(gaussians) - len(found)} of {len(gaussians)} Gaussians hold nothing that can be given back")
    write_container(context.output("container"), found, method)
    context.record(sealed=is_sealed(secret), gaussians=len(found))
