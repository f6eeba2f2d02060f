"""Artifacts for tests of watermarks: a capture of small photos, an emblem, a codec that changes pictures a little."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from pipeline.artifact import Artifact, create, load
from stages.finetune_rtws import FinetuneRtwsParameters, finetune_rtws
from stages.hiding.method import Method
from stages.hiding.storage import write_container
from stages.hiding.watermark.codec import WatermarkCodec, new_codec
from stages.hiding.watermark.rendering import renders
from stages.hiding.watermark.storage import write_codec
from stages.imaging.image import write_image
from stages.imaging.pictures import Picture, encode_png
from stages.scene.cameras import Cameras
from stages.scene.capture import Capture, write_capture
from stages.scene.gaussians import Gaussians
from stages.scene.scene import Scene, write_scene
from stages.training.network import NetworkTraining
from tests.running import run_stage
from tests.stages import small
from tests.stages.small import HEIGHT, NAMES, WIDTH, pictures

Inputs = dict[str, Artifact | tuple[Artifact, ...]]


def capture(folder: Path, seed: int = 0) -> Artifact:
    """The pictures of the small scene, as photos."""
    return stored_capture(folder, dict(zip(NAMES, pictures(seed), strict=True)))


def stored_capture(folder: Path, photos: Mapping[str, Picture]) -> Artifact:
    """A capture of these photos, by name."""
    names = tuple(photos)
    sizes = tuple((photo.shape[1], photo.shape[0]) for photo in photos.values())
    with create(folder, "capture") as writer:
        write_capture(writer, Capture(names, sizes, (None,) * len(names), True), lambda name: encode_png(photos[name]))
    return load(folder)


def emblem(folder: Path) -> Artifact:
    picture = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    picture[6:18, 8:24] = (250, 200, 20)
    with create(folder, "image") as writer:
        write_image(writer, "emblem", picture)
    return load(folder)


def stored_splats(folder: Path, gaussians: Gaussians, method: Method) -> Artifact:
    with create(folder, "splats") as writer:
        write_container(writer, gaussians, method)
    return load(folder)


def stored_scene(folder: Path, gaussians: Gaussians, method: Method, cameras: Cameras) -> Artifact:
    """A scene of the Gaussians' renders from these cameras; the first two are test views."""
    shown = renders(gaussians, method, cameras, lambda: None)
    points = gaussians.means.numpy()[::25]
    with create(folder, "scene") as writer:
        write_scene(writer, Scene(cameras, shown, points, np.full((len(points), 3), 128, np.uint8), cameras.names[:2]))
    return load(folder)


def little_codec() -> WatermarkCodec:
    """A codec that changes pictures a little when it hides something in them."""
    codec = new_codec(1, 4, seed=0)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for weight in codec.network.parameters():
            weight += 0.02 * torch.randn(weight.shape, generator=generator)
    return codec


def codec(folder: Path, tuned_to: torch.Tensor | None = None, blocks: int = 1, width: int = 4) -> Artifact:
    made = little_codec() if (blocks, width) == (1, 4) else new_codec(blocks, width, seed=0)
    if tuned_to is not None:
        made = new_codec(1, 4, seed=0)
        made.expect(tuned_to)
    with create(folder, "codec") as writer:
        write_codec(writer, made.requires_grad_(False))
    return load(folder)


def errors_of(training: NetworkTraining, iteration: int) -> dict[str, float]:
    """The errors of one step of a training, by their names."""
    errors: dict[str, float] = {}
    for terms in training.errors(iteration):
        for name, term in terms.items():
            errors[name] = errors.get(name, 0) + term.item()
    return errors


def inputs_of_rtws(folder: Path) -> Inputs:
    """Splats of 3DGS, their scene, a codec and an emblem."""
    return {
        "container": small.splats(folder / "splats"),
        "cover": small.scene(folder / "scene"),
        "codec": codec(folder / "codec"),
        "watermark": emblem(folder / "emblem"),
    }


def finetuned(folder: Path, inputs: Inputs, **settings: object) -> dict[str, Artifact]:
    """What `finetune_rtws` makes of splats in a few iterations."""
    parameters = FinetuneRtwsParameters.model_validate({"method": "plain", "iterations": 6} | settings)
    return run_stage(finetune_rtws, parameters, inputs, folder)
