"""Measures what a lower precision of the decoders costs in quality: the same hiding in float32 and in that, per seed.

    python -m tests.benchmarks.decoder_precision COVER_SCENE MESSAGE_VIEWS [METHOD [ITERATIONS [SEEDS [PRECISION]]]]

Both folders are artifacts in a store: a scene, and views rendered from that scene's cameras. PRECISION is bfloat16 by
default, or tf32, which the CPU imitates by rounding the factors of convolutions as NVIDIA's GPUs do. With one seed,
both trainings have the same initial Gaussians and decoders and the same order of views, so that they differ only by the
precision and by the chance effects that it sets off; the spread over seeds shows how large these are. Training views,
as seen in the last fifth of the iterations, reveal more about the precision than test views, which vary more by chance.
"""

from __future__ import annotations

import math
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pipeline.artifact import Artifact, load
from stages.hide_scenes import HideScenesParameters, hide_scenes
from stages.hiding import decoders
from stages.hiding.convolution import Convolution
from stages.hiding.decoders import Precision
from stages.hiding.photographs import photographs
from stages.hiding.rendering import COVER
from stages.hiding.storage import read_gaussians, read_method
from stages.imaging.metric_table import read_rows
from stages.imaging.pictures import picture_to_tensor
from stages.imaging.psnr import psnr
from stages.scene.message_views import read_message_pictures
from stages.scene.scene import read_scene
from tests.running import run_stage

BOUND = 0.1
"""Decibels by which a lower precision may differ from float32."""


class _Rounded(torch.autograd.Function):
    """Rounds values, or only their gradient (`backward`), to 10 bits of mantissa: to nearest, ties away from zero."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, backward: bool) -> Tensor:
        ctx.backward = backward
        return values.view_as(values) if backward else with_ten_bits(values)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return (with_ten_bits(gradient) if ctx.backward else gradient), None


def with_ten_bits(values: Tensor) -> Tensor:
    return ((values.contiguous().view(torch.int32) + 0x1000) & ~0x1FFF).view(torch.float32)


def imitate_tf32() -> None:
    """From now on, round the factors of convolutions on the CPU, forward and backward, where a GPU would."""
    forward = Convolution.forward

    def rounding(module: Convolution, values: Tensor, rectified: bool = False, rounded: bool = False) -> Tensor:
        if not rounded:
            return forward(module, values, rectified)
        weights = {"weight": _Rounded.apply(module.weight, False), "bias": module.bias}
        convolved = torch.func.functional_call(module, weights, (_Rounded.apply(values, False),))
        convolved = _Rounded.apply(convolved, True)
        return torch.relu(convolved) if rectified else convolved

    Convolution.forward = rounding  # type: ignore[method-assign]
    decoders.works_in_place = lambda device: False  # type: ignore[assignment]  # its kernel rounds nothing


def decibels_on_test_views(cover: Artifact, message: Artifact, made: Mapping[str, Artifact]) -> dict[str, float]:
    """Mean PSNR of the cover and of the message over the test views."""
    scene = read_scene(cover)
    truths = {COVER: scene.pictures}
    truths |= {name: views.pictures for name, views in read_message_pictures([message], scene.cameras.names).items()}
    gaussians, method = read_gaussians(made["container"]), read_method(made["container"], made["secret"])
    decibels: dict[str, list[float]] = {name: [] for name in truths}
    rows = scene.rows(scene.test_names)
    for row, rendering in zip(
        rows, photographs(gaussians, method, scene.cameras.select(scene.test_names)), strict=True
    ):
        for name, pictures in truths.items():
            truth = picture_to_tensor(pictures[row])
            decibels[name].append(psnr(rendering.pictures[name].clamp(0, 1), truth))
    return {name: statistics.mean(values) for name, values in decibels.items()}


def decibels_at_the_end(curves: Artifact, iterations: int) -> dict[str, float]:
    """Mean PSNR of the training views that were drawn in the last fifth of the iterations."""
    decibels: dict[str, list[float]] = {}
    for row in read_rows(curves):
        if row.quantity == "psnr" and row.iteration is not None and row.iteration > 0.8 * iterations:
            decibels.setdefault(f"{row.message or COVER} in training", []).append(row.value)
    return {name: statistics.mean(values) for name, values in decibels.items()}


def trained(
    cover: Artifact, message: Artifact, method: str, iterations: int, seed: int, precision: Precision
) -> dict[str, float]:
    """Decibels after a training of few Gaussians, with λ = 0.25 and one thread.

    All methods have decoders 32 wide and starting points of the message, as ours has by default.
    """
    parameters = HideScenesParameters.model_validate(
        {
            "method": method,
            "iterations": iterations,
            "seed": seed,
            "precision": precision,
            "decoder_width": 32,
            "maximum_gaussians": 50_000,
            "message_points": 4000,
            "lambda_message": 0.25,
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        made = run_stage(hide_scenes, parameters, {"cover": cover, "messages": (message,)}, Path(folder))
        return decibels_on_test_views(cover, message, made) | decibels_at_the_end(made["curves"], iterations)


def described(name: str, precision: Precision, differences: Sequence[float]) -> str:
    """A line with the mean difference, twice its standard error, and the verdict."""
    mean, error = statistics.mean(differences), 2 * statistics.stdev(differences) / math.sqrt(len(differences))
    verdict = "within" if abs(mean) + error <= BOUND else "not shown to be within"
    difference = f"{mean:+.3f} ± {error:.3f} dB over {len(differences)} seeds"
    return f"{name}: {precision} less float32 {difference}, {verdict} {BOUND}"


def main(
    cover: Path,
    message: Path,
    method: str = "homogeneous",
    iterations: int = 1000,
    seeds: int = 3,
    coarse: Precision = "bfloat16",
) -> None:
    scene, views = load(cover), load(message)
    imitate_tf32()
    differences: dict[str, list[float]] = {}
    for seed in range(seeds):
        decibels: dict[str, dict[str, float]] = {}
        precisions: tuple[Precision, ...] = ("float32", coarse)
        for precision in precisions:
            start = time.process_time()
            decibels[precision] = trained(scene, views, method, iterations, seed, precision)
            seconds = time.process_time() - start
            figures = ", ".join(f"{name} {value:.2f} dB" for name, value in decibels[precision].items())
            print(f"{method}, seed {seed}, {precision:8}: {figures}; {seconds:.0f} s of processors", flush=True)
        for name, value in decibels[coarse].items():
            differences.setdefault(name, []).append(value - decibels["float32"][name])
    for name, values in differences.items():
        print(described(name, coarse, values), flush=True)


if __name__ == "__main__":
    folders, numbers, precision = sys.argv[1:3], sys.argv[4:6], sys.argv[6:7]
    main(*map(Path, folders), *sys.argv[3:4], *map(int, numbers), *precision)  # type: ignore[arg-type]
