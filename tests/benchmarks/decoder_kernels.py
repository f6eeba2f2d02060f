"""Times our CPU kernels for decoders and for the separation penalty against torch's own operations, on one core.

    POCL_MAX_PTHREAD_COUNT=1 python -m tests.benchmarks.decoder_kernels [--height 200] [--width 112]

Prints the minimum milliseconds over interleaved repeats, and their ratio.
`ONEDNN_MAX_CPU_ISA=AVX2 ATEN_CPU_CAPABILITY=avx2` before the command restricts torch, and only torch, to what
processors without AVX-512 have.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from itertools import pairwise

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from opencl.convolution import convolve
from opencl.pixel_decoder import decode_pixels
from pipeline.run.freed_memory import keep_freed_memory
from tests.opencl import test_separation

REPEATS = 15
CHANNELS = [(64, 64), (16, 64), (32, 32), (96, 96)]
"""(In, out) of GS-Hider's inner convolutions and of its first, of a decoder half as wide, and of a wider one."""
LAYERS = (16, 32, 32, 32, 32, 3)
"""Channels of the input and of each layer of our decoder."""
GAUSSIANS = (60_000, 150_000)

Step = Callable[[], object]


def milliseconds(steps: dict[str, Step]) -> dict[str, float]:
    """The minimum time of each step."""
    least = dict.fromkeys(steps, float("inf"))
    for repeat in range(REPEATS + 2):
        for name, step in steps.items():
            start = time.perf_counter()
            step()
            if repeat >= 2:
                least[name] = min(least[name], 1e3 * (time.perf_counter() - start))
    return least


def compare(title: str, ours: Step, torchs: Step) -> None:
    found = milliseconds({"ours": ours, "torch": torchs})
    ratio = found["ours"] / found["torch"]
    print(f"{title:52} {found['ours']:8.2f} ms {found['torch']:8.2f} ms {ratio:6.2f}", flush=True)


def compare_convolutions(channels: int, outputs: int, height: int, width: int) -> None:
    """Time the forward pass, and the backward pass for the input and for the weights."""
    values = torch.randn(1, channels, height, width).to(memory_format=torch.channels_last)
    weight = (torch.randn(outputs, channels, 3, 3) / 24).to(memory_format=torch.channels_last)
    bias = torch.randn(outputs)
    gradient = torch.randn(1, outputs, height, width).to(memory_format=torch.channels_last)
    ways = {
        "ours": lambda *given: convolve(*given),
        "torch": lambda values, weight, bias: conv2d(values, weight, bias, padding=1),
    }
    title = f"{channels} to {outputs} channels, 3 x 3"
    compare(f"{title}, forward", *(lambda way=way: way(values, weight, bias) for way in ways.values()))
    for name, leaves in {"input": [values], "weights": [weight, bias]}.items():

        def backward(way: Callable[..., Tensor], leaves: list[Tensor] = leaves) -> Step:
            for tensor in (values, weight, bias):
                tensor.requires_grad_(any(tensor is leaf for leaf in leaves))
            convolved = way(values, weight, bias)
            return lambda: torch.autograd.grad(convolved, leaves, gradient, retain_graph=True)

        compare(f"{title}, gradient of the {name}", *(backward(way) for way in ways.values()))


def compare_decoders(height: int, width: int) -> None:
    """Time forward and backward together, for one decoder."""
    picture = torch.rand(height, width, LAYERS[0], requires_grad=True)
    layers = list(pairwise(LAYERS))
    weights = [(torch.randn(out, into) / into**0.5).requires_grad_() for into, out in layers]
    biases = [torch.randn(out).requires_grad_() for _, out in layers]

    def by_convolutions() -> Tensor:
        values = picture.permute(2, 0, 1).unsqueeze(0)
        for number, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            values = conv2d(values.relu() if number else values, weight[..., None, None], bias)
        return values

    def both_ways(decoded: Callable[[], Tensor]) -> Step:
        return lambda: torch.autograd.grad(decoded().square().mean(), [picture, *weights, *biases])

    steps = both_ways(lambda: decode_pixels(picture, weights, biases)), both_ways(by_convolutions)
    compare(f"{' '.join(map(str, LAYERS))} channels, 1 x 1, both ways", *steps)


def compare_separations(count: int) -> None:
    """Time forward and backward together, for the separation penalty of two pictures."""
    features = torch.randn(count, 16, requires_grad=True)
    directions, readings = torch.linalg.qr(torch.randn(16, 16))[0].split([2, 14])
    readings = readings.reshape(2, 7, 16).clone().requires_grad_()

    def both_ways(way: Callable[..., Tensor]) -> Step:
        return lambda: torch.autograd.grad(way(features, directions, readings), [features, readings])

    title = f"what keeps 2 pictures of {count:,} Gaussians apart"
    compare(title, *(both_ways(way) for way in (test_separation.penalty, test_separation.expected)))


def main(height: int, width: int) -> None:
    torch.set_num_threads(1)
    keep_freed_memory()
    print(f"{width} x {height} pixels, torch for {torch.backends.cpu.get_cpu_capability()}: ours, torch's, ratio")
    for channels, outputs in CHANNELS:
        compare_convolutions(channels, outputs, height, width)
    compare_decoders(height, width)
    for count in GAUSSIANS:
        compare_separations(count)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--height", type=int, default=200)
    parser.add_argument("--width", type=int, default=112)
    arguments = parser.parse_args()
    main(arguments.height, arguments.width)
