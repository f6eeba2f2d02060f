"""Measures whole trainings on the device that stages use: how long they take, and the quality of the results.

    python -m tests.benchmarks.whole_trainings FOLDER COVER_SCENE MESSAGE_SCENE [METHOD ...] [--iterations N]
        [--message-iterations N] [--gaussians N] [--precision NAME]

Both scenes are artifacts of kind scene in a store. First, 3DGS of the message is trained and rendered from the cover's
cameras; then each METHOD is trained, scored and its frames timed: plain, gs_hider, homogeneous, sh or decoder; by
default the first three. Finished stages are kept in FOLDER, which is for one set of options, and not repeated, so that
an interrupted run continues after the last of them. Not yet run on a GPU.
"""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Mapping
from pathlib import Path

import torch

from opencl.routes import describe_drawing, working_device
from pipeline.artifact import Artifact, load
from pipeline.run.freed_memory import keep_freed_memory
from pipeline.stage import Parameters, Services, Stage
from stages.evaluate import EvaluateParameters, evaluate
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding.method_names import PLAIN
from stages.imaging.metric_table import read_rows
from stages.render_hidden import RenderHiddenParameters, render_hidden
from stages.time_frames import TimeFramesParameters, time_frames
from stages.train_scene import TrainSceneParameters, train_scene
from tests.running import run_stage

METHODS = (PLAIN, "gs_hider", "homogeneous")


class Work:
    """Runs stages one after the other, each in a folder of its own."""

    def __init__(self, folder: Path, threads: int) -> None:
        self.folder, self.threads = folder, threads

    def done(
        self, name: str, declared: Stage, parameters: Parameters, inputs: Mapping[str, Artifact | tuple[Artifact, ...]]
    ) -> dict[str, Artifact]:
        """The outputs of a stage, which runs unless they exist. If it runs, its log and seconds are printed."""
        folder = self.folder / name
        if all((folder / output).is_dir() for output in declared.outputs):
            return {output: load(folder / output) for output in declared.outputs}
        for output in declared.outputs:  # what an interrupted run left; its checkpoints are kept
            for unfinished in (folder / f".{output}", folder / output):
                shutil.rmtree(unfinished, ignore_errors=True)
        start = time.perf_counter()
        services = Services(log=lambda text: print(f"{name}: {text}", flush=True))
        made = run_stage(declared, parameters, inputs, folder, services=services)
        print(f"{name}: {time.perf_counter() - start:.1f} s", flush=True)
        return made


def main(arguments: argparse.Namespace) -> None:
    torch.set_num_threads(arguments.threads)
    keep_freed_memory()
    print(describe_drawing(working_device()), f"torch {torch.__version__}, {arguments.threads} threads", flush=True)
    work = Work(arguments.folder, arguments.threads)
    cover, message = load(arguments.cover), load(arguments.message)
    trained = {"maximum_gaussians": arguments.gaussians, "threads": arguments.threads}
    of_message = TrainSceneParameters(iterations=arguments.message_iterations, **trained)
    splats = work.done("message", train_scene, of_message, {"scene": message})["splats"]
    placed = RenderHiddenParameters(name="message", threads=arguments.threads)
    views = work.done("views", render_hidden, placed, {"splats": splats, "message": message, "cover": cover})["views"]
    for method in arguments.methods or METHODS:
        if method == PLAIN:
            parameters: Parameters = TrainSceneParameters(iterations=arguments.iterations, **trained)
            made = work.done(method, train_scene, parameters, {"scene": cover})
        else:
            parameters = HideScenesParameters.model_validate(
                {"method": method, "iterations": arguments.iterations, "precision": arguments.precision, **trained}
            )
            made = work.done(method, hide_scenes, parameters, {"cover": cover, "messages": (views,)})
        report(work, method, made, cover, views)
    if torch.cuda.is_available():
        print(f"most of the GPU's memory: {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB")


def report(work: Work, method: str, made: Mapping[str, Artifact], cover: Artifact, views: Artifact) -> None:
    """Print scores on test views, sizes in bytes, and the time of a frame."""
    container = made["splats"] if method == PLAIN else made["container"]
    inputs: dict[str, Artifact | tuple[Artifact, ...]] = {"container": container, "cover": cover}
    hidden: dict[str, Artifact | tuple[Artifact, ...]] = {}
    if method != PLAIN:
        hidden = {"secret": made["secret"], "messages": (views,)}
    scored = EvaluateParameters.model_validate({"method": method, "lpips": "none", "threads": work.threads})
    scores = work.done(f"{method}_scores", evaluate, scored, inputs | hidden)["scores"]
    found: dict[tuple[str, str], list[float]] = {}
    for row in read_rows(scores):
        if row.split != "train":
            found.setdefault((row.quantity, row.message or "cover"), []).append(row.value)
    for (quantity, picture), values in found.items():
        print(f"  {method}, {picture}, {quantity}: {sum(values) / len(values):.4f}", flush=True)
    timed = TimeFramesParameters.model_validate({"method": method, "threads": work.threads})
    for row in read_rows(work.done(f"{method}_frames", time_frames, timed, inputs)["timings"]):
        print(f"  {method}, {row.quantity}: {row.value * 1e3:.2f} ms", flush=True)


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("cover", type=Path)
    parser.add_argument("message", type=Path)
    parser.add_argument("methods", nargs="*", metavar="METHOD")
    parser.add_argument("--iterations", type=int, default=7000)
    parser.add_argument("--message-iterations", type=int, default=3000)
    parser.add_argument("--gaussians", type=int, default=10_000_000)
    parser.add_argument("--precision", default="tf32")
    parser.add_argument("--threads", type=int, default=4)
    return parser


if __name__ == "__main__":
    main(parser().parse_args())
