"""The command `python -m opencl bench`: its options and its output."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from opencl.bench import report
from opencl.bench.implementations import OURS, PEERS, Implementation
from opencl.bench.limits import Limits, measure_limits
from opencl.bench.measuring import Measurement, measure
from opencl.bench.processes import in_fresh_process
from opencl.bench.profiling import Profile, profile
from opencl.bench.roofline import kernel_share
from opencl.bench.workloads import BOXES, DEFAULT_WORKLOADS, TrainedScene, Workload, box_named
from opencl.device import DEVICE_VARIABLE, Device, choose_device

Say = Callable[..., None]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    names = ", ".join(box.name for box in BOXES)
    parser.add_argument("--device", help=f"index or part of the name; else ${DEVICE_VARIABLE}, else the default")
    parser.add_argument(
        "--workload",
        action="append",
        metavar="NAME",
        help=f"one of {names}; may be repeated (default: {', '.join(DEFAULT_WORKLOADS)}; with --splats none)",
    )
    parser.add_argument(
        "--splats", nargs="+", type=Path, default=[], metavar="FILE", help="trained scenes: .splat or compressed .ply"
    )
    parser.add_argument("--repetitions", type=int, default=11, help="calls of each that are counted (default: 11)")
    parser.add_argument(
        "--peers",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="measure other rasterizers that are installed, too; they take minutes (default: yes)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")


def run(options: argparse.Namespace) -> None:
    """Measure and print. Raises ValueError for invalid options, and RuntimeError if our own rasterizer fails."""
    workloads = _workloads(options)
    if options.repetitions < 1:
        raise ValueError(f"--repetitions: found {options.repetitions}, expected 1 or more")
    if options.device is not None:
        os.environ[DEVICE_VARIABLE] = options.device  # the measuring processes read it
    device = choose_device()
    device.prepare()
    peers = [peer for peer in PEERS if options.peers and peer.is_installed]
    missing = [peer.how_to_install for peer in PEERS if options.peers and not peer.is_installed]
    say: Say = _keep_quiet if options.json else _say
    say(*report.device_lines(device), *missing)
    limits = in_fresh_process(measure_limits)
    say(report.limits_line(limits))
    results = [_run_workload(workload, device, peers, options.repetitions, limits, say) for workload in workloads]
    if options.json:
        how = {"device": device.describe(), "copies": not device.shares_memory}
        whole = {**how, "limits": dataclasses.asdict(limits), "missing": missing}
        print(json.dumps({**whole, "workloads": results}, indent=1))


def _say(*lines: str) -> None:
    for line in lines:
        print(line, flush=True)


def _keep_quiet(*lines: str) -> None:
    pass


def _workloads(options: argparse.Namespace) -> list[Workload]:
    for path in options.splats:
        if not path.is_file():
            raise ValueError(f"--splats: {path} is no file")
    named = options.workload or ([] if options.splats else DEFAULT_WORKLOADS)
    return [*(box_named(name) for name in named), *(TrainedScene(path) for path in options.splats)]


def _run_workload(
    workload: Workload, device: Device, peers: list[Implementation], repetitions: int, limits: Limits, say: Say
) -> dict[str, Any]:
    """Measure a workload, printing results as they arrive. Returns its entry for `--json`."""
    profiled = in_fresh_process(profile, workload, repetitions)
    counts = profiled.counts
    say("", *report.workload_lines(workload, counts), report.header_line(device))
    ours = measure(OURS, workload, repetitions)
    say(report.measurement_line(ours, ours, counts), report.processors_line(ours))
    measurements, failures = [ours], {}
    for peer in peers:
        if peer.largest is not None and counts.gaussians > peer.largest:
            failures[peer.name] = (
                f"not measured on more than {peer.largest:,} Gaussians, as it would need too much memory"
            )
            say(f"  {peer.name}: {failures[peer.name]}")
            continue
        try:
            measurements.append(measure(peer, workload, repetitions))
        except RuntimeError as error:
            failures[peer.name] = str(error)
            say(f"  {peer.name}: {error}")
            continue
        say(report.measurement_line(measurements[-1], ours, counts), report.processors_line(measurements[-1]))
        say(report.differences_line(peer.name))
    say(*report.kernel_lines(profiled, limits))
    return _as_json(workload, profiled, measurements, failures, limits)


def _as_json(
    workload: Workload,
    profiled: Profile,
    measurements: list[Measurement],
    failures: dict[str, str],
    limits: Limits,
) -> dict[str, Any]:
    shares = [kernel_share(name, seconds, profiled.counts, limits) for name, seconds in profiled.kernels.items()]
    return {
        "workload": workload.name,
        "counts": dataclasses.asdict(profiled.counts),
        "measurements": [dataclasses.asdict(one) for one in measurements],
        "not_measured": failures,
        "kernels": [dataclasses.asdict(share) for share in shares],
        "profiled_seconds": profiled.seconds,
    }
