"""`image`: a picture to hide, from a file or from a capture."""

from __future__ import annotations

from pydantic import Field

from pipeline.errors import UserError, nearest
from pipeline.stage import Context, ExternalPath, Input, Output, Parameters, stage
from stages.hiding.message_names import MessageName
from stages.imaging.image import write_image
from stages.imaging.pictures import read_picture
from stages.scene.capture import picture_path, read_capture


class ImageParameters(Parameters):
    """Which picture is read."""

    name: MessageName = Field("image", description="The image's name in the secret and in the tables.")
    file: ExternalPath | None = Field(
        None, description="A picture file. Leave it out to take a photo of the input capture instead."
    )
    photo: str | None = Field(None, description="Name of the photo in the capture; by default, the first.")


@stage(inputs={"capture": Input("capture", optional=True)}, outputs={"image": Output("image")}, version=1)
def image(context: Context, parameters: ImageParameters) -> None:
    """Read the picture, upright and as RGB.

    Raises `UserError` unless there is either a file or a capture, and if the capture has no such photo.
    """
    capture = context.input_optional("capture")
    if (capture is None) == (parameters.file is None):
        raise UserError(
            "the image needs exactly one source",
            found="neither a file nor a capture" if capture is None else "both a file and a capture",
            expected="either the parameter file or the input capture",
        )
    if parameters.file is not None:
        path = parameters.file
    else:
        assert capture is not None
        names = read_capture(capture).names
        photo = parameters.photo or names[0]
        if photo not in names:
            raise UserError(
                "the capture has no such photo",
                found=photo,
                expected=f"{names[0]} to {names[-1]}{nearest(photo, names)}",
            )
        path = picture_path(capture, photo)
    write_image(context.output("image"), parameters.name, read_picture(path))
