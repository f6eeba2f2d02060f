"""`import_grain`: what the owner of a container with a grain kept, for detecting the grain in pictures that turn up."""

from __future__ import annotations

import torch
from pydantic import Field

from pipeline.errors import UserError
from pipeline.stage import Context, ExternalPath, Output, Parameters, stage
from stages.hiding.key import key_generator, write_key
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container
from stages.hiding.watermark.coins import thrown
from stages.hiding.watermark.grain import follows
from stages.scene.verified_copy import verified_copy

REMEDY = "Give results of one run, as they lie in a store or as `export` copied them, unpacked if zipped."


class ImportGrainParameters(Parameters):
    """Where the owner's files are, and the container's method."""

    before: ExternalPath = Field(
        description="The container before grain was added, such as hide_photos/hide.container, as copied by the "
        "command `export` or as found in a store."
    )
    after: ExternalPath = Field(
        description="The container with grain, before sealing, such as hide_photos/grain.container."
    )
    key: ExternalPath = Field(description="The grain's key, such as hide_photos/grain_key.key.")
    method: MethodName = Field("gs_hider", description="The container's method.")


@stage(
    inputs={},
    outputs={"before": Output("container", privacy="private"), "key": Output("key", privacy="private")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def import_grain(context: Context, parameters: ImportGrainParameters) -> None:
    """Check every byte, that there is a grain, and that it follows the key; output what `find_grain` needs to read it.

    Without these checks, pictures of a container published without a grain, or files of two different runs, would be
    scored in vain. Raises `UserError` if one of the three is missing, broken, or of another run.
    """
    before = verified_copy(parameters.before, "container", REMEDY)
    after = verified_copy(parameters.after, "container", REMEDY)
    key = verified_copy(parameters.key, "key", REMEDY)
    for container in (before, after):
        check_method(container, parameters.method)
    gaussians, changed = read_gaussians(before), read_gaussians(after)
    if gaussians.parameters.keys() == changed.parameters.keys() and all(
        torch.equal(values, changed[name]) for name, values in gaussians.parameters.items()
    ):
        raise UserError(
            "the container has no grain",
            where=parameters.after,
            found="the same Gaussians as before the grain",
            expected="a run with `--set grain=1.5`, or another level above 0",
            remedy="Pictures of a container published without grain cannot be identified.",
        )
    coins = thrown(len(gaussians), key_generator(key, 0))
    if not follows(gaussians, changed, coins):
        raise UserError(
            "the grain does not match the key",
            where=parameters.after,
            found="differences between the Gaussians before and after that do not follow from the key",
            expected="both containers and the key from the same run",
            remedy=REMEDY,
        )
    write_container(context.output("before"), gaussians, read_method(before))
    write_key(context.output("key"), key.read("key").tobytes())
    context.record(gaussians=len(gaussians))
