"""Formats measurements as lines of text."""

from __future__ import annotations

from opencl.bench.counts import Counts
from opencl.bench.implementations import implementation_named
from opencl.bench.limits import Limits
from opencl.bench.measuring import Measurement
from opencl.bench.profiling import Profile
from opencl.bench.roofline import kernel_share
from opencl.bench.workloads import Workload
from opencl.device import Device


def device_lines(device: Device) -> list[str]:
    """The device measured and, if tensors are copied to it, a note on that."""
    copies = "tensors of the CPU, by copies both ways, which are in all times but the kernels'; memory is the host's"
    return [device.describe()] if device.shares_memory else [device.describe(), copies]


def limits_line(limits: Limits) -> str:
    return (
        f"limits of the device: {limits.flops / 1e9:.0f} GFLOP/s, "
        f"reads {limits.read_bytes / 1e9:.1f} GB/s, writes {limits.write_bytes / 1e9:.1f} GB/s"
    )


def workload_lines(workload: Workload, counts: Counts) -> list[str]:
    return [
        f"{workload.name}: {counts.gaussians:,} Gaussians, {counts.visible:,} visible with a mean 3-sigma radius of "
        f"{counts.mean_radius:.1f} pixels; {counts.pixels:,} pixels, M={counts.feature_dim}",
        f"  pairs: {counts.tile_pairs:,} (tile, Gaussian); {counts.evaluations / 1e6:.1f} million (pixel, Gaussian) "
        f"in those tiles, {counts.contributing / 1e6:.1f} million contribute",
    ]


def header_line(device: Device) -> str:
    memory = "peak memory" if device.shares_memory else "peak host memory"
    return (
        f"  {'':18} {'forward':>21} {'forward + backward':>21} "
        f"{'ns/evaluation':>14} {'ns/contributing':>16} {memory:>17}"
    )


def measurement_line(measurement: Measurement, ours: Measurement, counts: Counts) -> str:
    """Times and memory of an implementation and, if it is not ours, the speedup of ours over it."""
    columns = []
    for times, reference in (
        (measurement.forward, ours.forward),
        (measurement.forward_backward, ours.forward_backward),
    ):
        ratio = f"({times.seconds / reference.seconds:.1f}x)" if measurement is not ours else ""
        columns.append(f"{times.seconds * 1e3:9.1f} ms {ratio:>9}")
    forward, both = measurement.forward.seconds * 1e9, measurement.forward_backward.seconds * 1e9
    memory = (measurement.memory.forward, measurement.memory.forward_backward)
    name = measurement.implementation
    if measurement.feature_dim < counts.feature_dim:
        name += f" (M={measurement.feature_dim})"
    return (
        f"  {name:18} {columns[0]} {columns[1]} "
        f"{forward / counts.evaluations:6.2f} {both / counts.evaluations:7.2f} "
        f"{forward / counts.contributing:8.2f} {both / counts.contributing:7.2f} "
        f"{memory[0] / 2**30:7.2f} {memory[1] / 2**30:5.2f} GiB"
    )


def processors_line(measurement: Measurement) -> str:
    """CPU time summed over all processors, and the number of calls."""
    forward, both = measurement.forward, measurement.forward_backward
    return (
        f"  {'':18} {forward.processor_seconds * 1e3:9.1f} and {both.processor_seconds * 1e3:.1f} ms of processors; "
        f"medians of {forward.calls} and {both.calls} calls"
    )


def differences_line(name: str) -> str:
    return f"  {name}: {implementation_named(name).differences}"


def kernel_lines(profile: Profile, limits: Limits) -> list[str]:
    """Time of each kernel in a forward and backward pass, and the fractions of the device's limits it reaches."""
    lines = [f"  {'kernel':20} {'time':>10} {'share':>6} {'of peak arithmetic':>19} {'of peak bandwidth':>18}"]
    for kernel, seconds in profile.kernels.items():
        share = kernel_share(kernel, seconds, profile.counts, limits)
        line = f"  {kernel:20} {seconds * 1e3:7.2f} ms {seconds / profile.seconds:6.1%}"
        if share.arithmetic is not None and share.bandwidth is not None:
            line += f" {share.arithmetic:19.1%} {share.bandwidth:18.1%}"
        lines.append(line)
    outside = profile.seconds - sum(profile.kernels.values())
    lines.append(f"  {'outside kernels':20} {outside * 1e3:7.2f} ms {outside / profile.seconds:6.1%}")
    return lines
