"""`python -m opencl devices` lists OpenCL devices; `python -m opencl bench` measures the rasterizer on one of them."""

from __future__ import annotations

import argparse
import sys

from opencl.bench import command as bench
from opencl.device import DEVICE_VARIABLE, choose_device, list_devices
from opencl.routes import describe_route, missing_pieces


def main(arguments: list[str] | None = None) -> int:
    """Run the command. Returns 0, or 1 if a measurement fails, or 2 if a device, workload or file is not found."""
    parser = argparse.ArgumentParser(prog="python -m opencl", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("devices", help="list the devices and say which one is used")
    bench.add_options(
        commands.add_parser("bench", help="measure the rasterizer (medians; other work on the machine shows)")
    )
    chosen = parser.parse_args(arguments)
    try:
        if chosen.command == "devices":
            _list()
        else:
            bench.run(chosen)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return 1
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


if __name__ == "__main__":
    sys.exit(main())
