"""`time_frames`: how long one picture of the cover takes on one device, with and without its decoder.

The message decoder is not timed, since nobody can run it with only what is published; the paper's released code times
both.

The stage runs alone. Its device is recorded in the provenance. The cache key has only the name that the parameter
`device` gives it, since the machine that plans a run need not be the one that executes it.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

import torch
from pydantic import Field

from opencl.routes import describe_drawing, working_device
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.hiding.coupled import FEATURES
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.rendering import Rendering, splat
from stages.hiding.storage import check_drawn, read_gaussians, read_method
from stages.imaging.metric_table import MetricRow, write_rows
from stages.scene.cameras import Camera, single_cameras
from stages.scene.gaussians import Gaussians
from stages.scene.scene import read_scene
from stages.training.threads import Threads

Draw = Callable[[Camera], Rendering]


class TimeFramesParameters(Parameters):
    """How many frames are timed; the median is reported."""

    device: str = Field(
        "default", description="A name for the device; if machines share a store, give each kind of device its own."
    )
    method: MethodName = Field("gs_hider", description="The container's method.")
    frames: int = Field(30, ge=1, description="Number of frames timed, one test view after another.")
    warmup: int = Field(3, ge=0, description="Number of untimed frames rendered first.")
    threads: Threads = 2


@stage(
    inputs={"container": Input("container or splats"), "cover": Input("scene")},
    outputs={"timings": Output("metrics", privacy="public")},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
    alone=True,
)
def time_frames(context: Context, parameters: TimeFramesParameters) -> None:
    """Time what anyone can render: the decoded cover, and the feature map alone."""
    torch.set_num_threads(parameters.threads)
    container = context.input("container")
    check_drawn(container, parameters.method, context.input("cover"))
    device = working_device()
    gaussians, method = read_gaussians(container, device), read_method(container, device=device)
    scene = read_scene(context.input("cover"))
    cameras = single_cameras(scene.cameras.select(scene.test_names or scene.cameras.names))
    features = torch.zeros(len(gaussians), feature_dim(gaussians), device=device)
    drawings: dict[str, Draw] = {
        "seconds_per_frame": lambda camera: method.render(gaussians, camera),
        "seconds_per_feature_map": lambda camera: splat(gaussians, features, camera),
    }
    rows = [
        MetricRow(
            quantity,
            median_seconds(draw, cameras, parameters.warmup, parameters.frames, context.stop_if_requested),
            "s",
            method=parameters.method,
        )
        for quantity, draw in drawings.items()
    ]
    write_rows(context.output("timings"), rows)
    context.record(device=describe_drawing(device), threads=parameters.threads)


def feature_dim(gaussians: Gaussians) -> int:
    """M, the number of feature channels, or 3 if Gaussians have colours instead."""
    return gaussians[FEATURES].shape[1] if FEATURES in gaussians.parameters else 3


def wait_for(rendering: Rendering) -> None:
    """Wait until the GPU has rendered it: torch only queues work there. Returns at once on the CPU."""
    if rendering.feature_map.is_cuda:
        torch.cuda.synchronize(rendering.feature_map.device)


def median_seconds(
    draw: Draw, cameras: Sequence[Camera], warmup: int, frames: int, after_each: Callable[[], None] = lambda: None
) -> float:
    """Median seconds to draw one picture: over `frames` of them, after `warmup` untimed ones, camera after camera."""
    seconds = []
    for frame in range(warmup + frames):
        start = time.perf_counter()
        with torch.no_grad():
            wait_for(draw(cameras[frame % len(cameras)]))
        seconds.append(time.perf_counter() - start)
        after_each()
    return statistics.median(seconds[warmup:])
