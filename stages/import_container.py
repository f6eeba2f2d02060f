"""`import_container`: a container, and its secret, from the files that `export_container` writes."""

from __future__ import annotations

import torch
from pydantic import Field

from pipeline.stage import Context, ExternalPath, Output, Parameters, stage
from stages.hiding.altered_files import altered_files
from stages.hiding.bundle import CAMERAS, EXPORTED_WITH, IMAGE_CAMERA, SecretBundle, container_hash
from stages.hiding.bundle_files import read_container_bundle, read_secret_bundle
from stages.hiding.camera_reading import read_cameras_file
from stages.hiding.fitting import fitted_method
from stages.hiding.method import refuse_another_method
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.storage import write_container, write_secret
from stages.scene.garbage import refuse_garbage
from stages.scene.gaussians import Gaussians
from stages.scene.stored_cameras import write_cameras


class ImportContainerParameters(Parameters):
    """Where the files are, and the container's method."""

    bundle: ExternalPath = Field(
        description="Folder with container.ply, container.json, scene_decoder.safetensors, and, if it was published, "
        "cameras.json; or the PLY alone, where the method has no scene decoder."
    )
    secret: ExternalPath | None = Field(
        None,
        description="Folder with secret.json, message_decoder.safetensors, and, for a hidden image, "
        "image_camera.json; without a secret, only the cover is shown.",
    )
    method: MethodName = Field("gs_hider", description="The container's method, as container.json names it.")


@stage(
    inputs={},
    outputs={
        "container": Output("container"),
        "secret": Output("secret", privacy="private"),
        "cameras": Output("cameras"),
        "image_camera": Output("cameras", privacy="private"),
    },
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
    remarks="stages.hiding.remarks:not_as_exported",
)
def import_container(context: Context, parameters: ImportContainerParameters) -> None:
    """Read files that may come from anyone, and check that they fit their method before any artifact is made from them.

    `cameras` is a path from which to view the container, `image_camera` the camera from which the secret shows an
    image; each is empty if the bundles lack its file. Files that are not what was exported are recorded: they may fit
    the method and still be damaged, or of another container. So is a container other than the one that the secret was
    exported with, which secrets of earlier versions cannot tell.
    """
    bundle = read_container_bundle(parameters.bundle)
    secret = read_secret_bundle(parameters.secret) if parameters.secret else SecretBundle(())
    refuse_another_method(parameters.bundle, bundle.method, parameters.method)
    networks = {**bundle.networks, **secret.networks}
    where = parameters.bundle
    method = fitted_method(where, bundle.method, bundle.settings, secret.messages, bundle.shapes, networks)
    refuse_garbage(where, bundle.attributes)
    gaussians = Gaussians({name: torch.from_numpy(values) for name, values in bundle.attributes.items()})
    write_container(context.output("container"), gaussians, method)
    write_secret(context.output("secret"), method, secret.messages)
    facts = dict(secret.facts)
    exported_with = facts.pop(EXPORTED_WITH, None)
    context.output("secret").attributes |= facts
    write_cameras(context.output("cameras"), read_cameras_file(parameters.bundle, CAMERAS))
    hiding = read_cameras_file(parameters.secret, IMAGE_CAMERA) if parameters.secret else None
    write_cameras(context.output("image_camera"), hiding)
    places = [place for place in (parameters.bundle, parameters.secret) if place]
    context.record(
        method=bundle.method,
        gaussians=len(gaussians),
        altered=[name for place in places for name in altered_files(place)],
        another_container=exported_with is not None and exported_with != container_hash(bundle),
    )
