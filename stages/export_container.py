"""`export_container`: a container, and separately its secret, as files that other programs read."""

from __future__ import annotations

from pydantic import Field

from pipeline.artifact import Artifact, ArtifactWriter
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.bundle import (
    CAMERAS,
    IMAGE_CAMERA,
    SecretBundle,
    container_bundle,
    secret_bundle,
    write_container_bundle,
    write_secret_bundle,
)
from stages.hiding.camera_files import MOST_CAMERAS, cameras_file
from stages.hiding.what_is_hidden import view_of_an_image
from stages.scene.camera_path import camera_path
from stages.scene.cameras import Cameras
from stages.scene.scene import Scene, read_scene


class ExportContainerParameters(Parameters):
    """The camera path that is exported if the cover is given."""

    frames: int = Field(
        96, ge=2, le=MOST_CAMERAS, description="Number of cameras on the path; each is one frame of a viewer's video."
    )
    bends: int = Field(16, ge=3, description="Maximum number of bends in the path; fewer make it smoother.")


@stage(
    inputs={
        "container": Input("container"),
        "secret": Input("secret", optional=True),
        "cover": Input("scene", optional=True),
    },
    outputs={
        "bundle": Output("bundle", privacy="public"),
        "secret_bundle": Output("secret_bundle", privacy="private"),
    },
    version=1,
)
def export_container(context: Context, parameters: ExportContainerParameters) -> None:
    """Write the Gaussians as PLY and the decoders as safetensors; `import_container` reads them back bit for bit.

    The public bundle is made from the container and, for `view_container`, a smooth path along the cover's training
    cameras: it reveals neither photos, nor their names, nor, from two cameras on, where any of them was taken. An image
    hidden in one view is seen only from there, so the secret bundle has that camera. The command `export` copies any
    artifact, including a bundle, out of the store unchanged. Raises `UserError` for a private container.
    """
    container, secret = context.input("container"), context.input_optional("secret")
    if container.private:
        raise UserError(
            "this stage would publish a private container",
            where=str(container.path),
            found="a container that the workflow declares private",
            expected="a container that may be published",
            remedy="export the container that the stage `seal` makes, or remove the export from the workflow",
        )
    bundle = container_bundle(container)
    write_container_bundle(context.output("bundle"), bundle)
    write_secret_bundle(context.output("secret_bundle"), secret_bundle(secret, bundle) if secret else SecretBundle(()))
    if cover := context.input_optional("cover"):
        scene = read_scene(cover)
        context.output("bundle").write_file(CAMERAS, cameras_file(_path_along(scene, parameters)))
        _write_image_camera(context.output("secret_bundle"), scene, secret)
    context.record(method=bundle.method, gaussians=len(bundle.attributes["means"]))


def _path_along(scene: Scene, parameters: ExportContainerParameters) -> Cameras:
    """The path along the training cameras, or along all cameras if there are none; it does not depend on the secret."""
    cameras = scene.training_cameras
    return camera_path(cameras, scene.points, parameters.frames, parameters.bends)


def _write_image_camera(writer: ArtifactWriter, scene: Scene, secret: Artifact | None) -> None:
    view = view_of_an_image(secret, scene, "export_container")
    if view is not None:
        writer.write_file(IMAGE_CAMERA, cameras_file(scene.cameras.select([view])))
