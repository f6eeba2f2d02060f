"""Measures where the time of training iterations goes, in the middle of a training of given Gaussians.

    python -m tests.benchmarks.training_iteration METHOD SCENE SPLATS [VIEWS ...] [--iterations N] [--precision NAME]

METHOD is plain, homogeneous or gs_hider. The other arguments are artifacts in a store, or links to them in its
`latest`: the scene, trained splats or a container, and the messages' views. A method with decoders starts with new ones
and, on another method's Gaussians, with new features. Half of the iterations are before the end of density control and
half after it, as in a whole training.

It runs where stages do: on a CUDA GPU if there is one, unless GS_HIDER_DEVICE names another device. On the CPU, seconds
are processor time, which other work on the machine disturbs less than wall-clock time. On a GPU, they are wall-clock
time, and each part waits until the GPU has done it, which a training does not. Every training writes the same table, in
wall-clock time, to its stage's log. Checkpoints are timed by the clock as well: they mostly wait for the disk.

On one core of two (Emerald Rapids, fox, 60,000 Gaussians), an iteration takes

    plain           37.7 ms
    homogeneous     74.1 ms
    gs_hider       175.1 ms

On another Xeon with AMX, `--precision bfloat16` takes gs_hider from 182.2 to 118.8 ms, and homogeneous from 64.0 to
74.2.

Freed memory is kept, as in a worker; `--give-memory-back` leaves that to the allocator. On that processor, this makes
no difference; on Zen 4, iterations took a tenth longer.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import load
from pipeline.checkpoint import Checkpoints
from pipeline.run.freed_memory import keep_freed_memory
from pipeline.stage import Context, Services
from stages.hiding.method import build_method, move_networks
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians
from stages.scene.cameras import rig_extent
from stages.scene.gaussians import GEOMETRY, Gaussians
from stages.scene.message_views import read_message_pictures
from stages.scene.scene import read_scene
from stages.timing.stopwatch import Stopwatch, watching
from stages.training.density_control import DensitySettings
from stages.training.loop import Training, TrainingSettings
from stages.training.objectives import hiding_terms
from stages.training.state import state_of
from stages.training.views import training_views

DECODERS: dict[str, dict[str, object]] = {
    "homogeneous": {"decoder_width": 32, "kernel_size": 1},
    "gs_hider": {"decoder_width": 64, "kernel_size": 3},
}
"""The defaults of the stages that hide."""
WARM_UP = 5
WHOLE = 2_000
"""Iterations of the training whose middle is measured."""


def clock_of(device: torch.device) -> Callable[[], float]:
    """A clock for work on a device: processor time for the CPU; for a GPU, wall-clock time once all work is done."""
    if device.type == "cpu":
        return time.process_time

    def when_done() -> float:
        torch.cuda.synchronize(device)
        return time.perf_counter()

    return when_done


def prepared(arguments: argparse.Namespace, device: torch.device) -> Training:
    """A training, on a device, of Gaussians that have already been trained."""
    scene = read_scene(load(arguments.scene.resolve()))
    messages = read_message_pictures([load(folder.resolve()) for folder in arguments.views], scene.cameras.names)
    stored = read_gaussians(load(arguments.splats.resolve()))
    settings: dict[str, object] = {"sh_degree": 3}
    if arguments.method != "plain":
        settings = {"feature_dim": 16, "layers": 5, **DECODERS[arguments.method]}
        settings |= {"precision": arguments.precision, "messages": list(messages)}
    torch.manual_seed(0)
    method = build_method(arguments.method, settings)
    grey = dict.fromkeys((COVER, *messages), np.full((len(stored), 3), 0.5))
    fresh = method.initial_attributes(grey, np.random.default_rng(0))
    geometry = {name: stored[name] for name in GEOMETRY}
    attributes = fresh | {name: tensor for name, tensor in stored.attributes.items() if name in fresh}
    move_networks(method, device)
    return Training(
        Gaussians(geometry | attributes).to(device),
        method,
        training_views(scene, {name: views.pictures for name, views in messages.items()}),
        hiding_terms(list(messages), 0.25),
        replace(
            TrainingSettings(WHOLE, rig_extent(scene.cameras), seed=0),
            density=DensitySettings(maximum_gaussians=len(stored)),
        ),
    )


def main(arguments: argparse.Namespace) -> None:
    torch.set_num_threads(arguments.threads)
    if not arguments.give_memory_back:
        keep_freed_memory()
    device = working_device()
    training = prepared(arguments, device)
    first = training.schedule.stop - arguments.iterations // 2 + 1
    for iteration in range(first - WARM_UP, first):
        training.step(iteration)
    with watching(Stopwatch(clock_of(device))) as stopwatch:
        for iteration in range(first, first + arguments.iterations):
            training.step(iteration)
    camera = training.views.cameras[0]
    print(describe_drawing(device), f"torch {torch.__version__}, {arguments.threads} threads")
    print(f"{arguments.method}, {len(training.gaussians)} Gaussians, {camera.width}x{camera.height}: ", end="")
    print(stopwatch.table(arguments.iterations))
    print("checkpoints:", ", ".join(f"{seconds:.2f} s" for seconds in checkpoint_seconds(training, arguments.folder)))


def checkpoint_seconds(training: Training, folder: Path, count: int = 5) -> list[float]:
    """Seconds that each of a few checkpoints takes, including the deletion of the one before."""
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        checkpoints = Checkpoints(Context({}, {}, Path(scratch), "benchmark", Services()))
        seconds = []
        for _ in range(count):
            start = time.perf_counter()
            checkpoints.save(state_of(training))
            seconds.append(time.perf_counter() - start)
    return seconds


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("method", choices=("plain", "homogeneous", "gs_hider"))
    parser.add_argument("scene", type=Path)
    parser.add_argument("splats", type=Path)
    parser.add_argument("views", type=Path, nargs="*")
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--precision", default="float32")
    parser.add_argument("--give-memory-back", action="store_true")
    parser.add_argument("--folder", type=Path, help="Where checkpoints are written; a temporary folder by default.")
    return parser


if __name__ == "__main__":
    main(parser().parse_args())
