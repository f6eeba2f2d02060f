"""`export_container`: a container, and apart from it its secret, as files that other programs read."""

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
    """From where others look, where the cover is given."""

    frames: int = Field(96, ge=2, le=MOST_CAMERAS, description="Cameras of the path: pictures in a viewer's video.")
    bends: int = Field(16, ge=3, description="How many bends the path has at most: with fewer it is smoother.")


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
    """Write the Gaussians as PLY and decoders as safetensors; `import_container` reads them back bit for bit.

    The public bundle is made from the container alone, and from the cover a smooth path along its training cameras, for
    `view_container`: neither photos nor their names, nor from where any was taken. A picture that is hidden at one view
    is seen from there alone, so the secret bundle says where that is. The command `export` copies any artifact, a
    bundle too, out of the store as it is.
    """
    container, secret = context.input("container"), context.input_optional("secret")
    if container.private:
        raise UserError(
            "a private container would be published",
            where=str(container.path),
            found="a container that the workflow declares private",
            expected="one that may be given to anyone",
            remedy="give it what `seal` makes of the container and its secret, or take the export from the workflow",
        )
    bundle = container_bundle(container)
    write_container_bundle(context.output("bundle"), bundle)
    write_secret_bundle(context.output("secret_bundle"), secret_bundle(secret) if secret else SecretBundle(()))
    if cover := context.input_optional("cover"):
        scene = read_scene(cover)
        context.output("bundle").write_file(CAMERAS, cameras_file(_path_along(scene, parameters)))
        _write_image_camera(context.output("secret_bundle"), scene, secret)
    context.record(method=bundle.method, gaussians=len(bundle.attributes["means"]))


def _path_along(scene: Scene, parameters: ExportContainerParameters) -> Cameras:
    """The path along the training cameras, or along all where none was trained on: the secret has no say in it."""
    cameras = scene.training_cameras
    return camera_path(cameras, scene.points, parameters.frames, parameters.bends)


def _write_image_camera(writer: ArtifactWriter, scene: Scene, secret: Artifact | None) -> None:
    view = view_of_an_image(secret, scene, "export_container")
    if view is not None:
        writer.write_file(IMAGE_CAMERA, cameras_file(scene.cameras.select([view])))
