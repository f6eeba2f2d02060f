"""`synthesize`: photos of a procedural scene, ray-traced by us; the true cameras come with them, to check SfM only."""

from __future__ import annotations

import importlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from pipeline.errors import Interrupted
from pipeline.stage import Context, Output, Parameters, stage
from stages.imaging.pictures import encode_png
from stages.scene.capture import Capture, KnownPoses, Lens, write_capture
from stages.tracing.photograph import Studio
from stages.tracing.rig import orbit

SCENES = "stages.tracing.scenes"


class SynthesizeParameters(Parameters):
    """What is photographed, and how."""

    scene: Literal["courtyard", "library", "reef", "workshop"] = Field(description="Which of the built-in scenes.")
    views: int = Field(48, ge=1, le=999, description="Photos, on one closed walk about the scene.")
    width: int = Field(512, ge=16, description="Of a photo, in pixels.")
    height: int = Field(384, ge=16, description="Of a photo, in pixels.")
    samples: Literal[1, 4, 9, 16] = Field(4, description="Rays a pixel, one in each part of an even grid.")
    gloss: float = Field(1.0, ge=0, le=1, description="Scales highlights and mirror images.")
    seed: int = Field(0, ge=0, description="Of textures, small displacements, the walk and the rays.")
    threads: int = Field(2, ge=1, description="Photos taken at a time; the pictures do not depend on it.")


@stage(
    inputs={},
    outputs={"capture": Output("capture")},
    version=1,
    modules=lambda parameters: [f"{SCENES}.{parameters.scene}"],
)
def synthesize(context: Context, parameters: SynthesizeParameters) -> None:
    """Build the scene and walk about it with a camera."""
    size = (parameters.width, parameters.height)
    world = importlib.import_module(f"{SCENES}.{parameters.scene}").build(parameters.seed)
    studio = Studio(world, parameters.gloss, parameters.threads)
    poses, intrinsics = orbit(parameters.views, *size, parameters.seed)

    def photo(view: int) -> bytes:
        if context.stop_requested():
            raise Interrupted
        random = np.random.default_rng([parameters.seed, view])
        picture = studio.photograph(poses[view], intrinsics[view], *size, parameters.samples, random)
        return encode_png(picture)

    names = [f"{view:03d}.png" for view in range(parameters.views)]
    pictures: dict[str, bytes | Path] = {}
    with ThreadPoolExecutor(parameters.threads) as pool:
        for name, encoded in zip(names, pool.map(photo, range(parameters.views)), strict=True):
            pictures[name] = encoded
            context.progress(len(pictures), len(names))
    capture = Capture(
        names=tuple(names),
        sizes=(size,) * len(names),
        focal_pixels=tuple(float(matrix[0, 0]) for matrix in intrinsics),
        ordered=True,
        poses=KnownPoses("synthetic", poses, tuple(Lens.pinhole(matrix, *size) for matrix in intrinsics)),
    )
    write_capture(context.output("capture"), capture, pictures)
