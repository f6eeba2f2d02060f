"""`export_container`: a container, and apart from it its secret, as files that other programs read."""

from __future__ import annotations

from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.bundle import (
    SecretBundle,
    container_bundle,
    secret_bundle,
    write_container_bundle,
    write_secret_bundle,
)


class ExportContainerParameters(Parameters):
    """Nothing is to be chosen."""


@stage(
    inputs={"container": Input("container"), "secret": Input("secret", optional=True)},
    outputs={
        "bundle": Output("bundle", privacy="public"),
        "secret_bundle": Output("secret_bundle", privacy="private"),
    },
    version=1,
)
def export_container(context: Context, parameters: ExportContainerParameters) -> None:
    """Write the Gaussians as PLY and decoders as safetensors; `import_container` reads them back bit for bit.

    The public bundle is made from the container alone. The command `export` copies any artifact, a bundle too, out of
    the store as it is.
    """
    container, secret = context.input("container"), context.input_optional("secret")
    if container.private:
        raise UserError(
            "a private container would be published",
            where=str(container.path),
            found="a container that the workflow declares private",
            expected="one that may be given to anyone",
            remedy="take `private: true` from the stage that made it, or the export from the workflow",
        )
    bundle = container_bundle(container)
    write_container_bundle(context.output("bundle"), bundle)
    write_secret_bundle(context.output("secret_bundle"), secret_bundle(secret) if secret else SecretBundle(()))
    context.record(method=bundle.method, gaussians=len(bundle.attributes["means"]))
