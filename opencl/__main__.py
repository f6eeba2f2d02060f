"""`python -m opencl devices` lists OpenCL devices; `python -m opencl bench` measures the rasterizer on one of them."""

from __future__ import annotations

import argparse
import os
import sys

from opencl.backend import default_backend
from opencl.benchmark import WORKLOADS, measure, peak_memory
from opencl.device import DEVICE_VARIABLE, choose_device, list_devices
from opencl.routes import describe_route, missing_pieces


def main(arguments: list[str] | None = None) -> int:
    """The exit status: 0, or 2 where there is no such device."""
    parser = argparse.ArgumentParser(prog="python -m opencl", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("devices", help="list the devices and say which one is used")
    bench = commands.add_parser("bench", help="measure the rasterizer (medians; other work on the machine shows)")
    bench.add_argument("--device", help=f"index or part of the name; else ${DEVICE_VARIABLE}, else the default")
    bench.add_argument("--repetitions", type=int, default=11)
    chosen = parser.parse_args(arguments)
    try:
        if chosen.command == "devices":
            _list()
        else:
            if chosen.device is not None:
                os.environ[DEVICE_VARIABLE] = chosen.device
            _bench(chosen.repetitions)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _list() -> None:
    used = choose_device()
    devices = list_devices()
    for device in devices:
        mark = "*" if device.index == used.index else " "
        print(f"{mark} {device.index}  {device.describe()}\n      {describe_route(device)}")
    print(f"* is used for tensors of the CPU; choose another with {DEVICE_VARIABLE}=<index or part of the name>")
    for piece in missing_pieces(devices):
        print(piece)


def _bench(repetitions: int) -> None:
    backend = default_backend()
    print(backend.device.describe())
    for workload in WORKLOADS:
        print(measure(backend, workload, repetitions), flush=True)
    print(peak_memory())


if __name__ == "__main__":
    sys.exit(main())
