"""`python -m opencl.check`: whether stages that draw find their device, asked before a run begins.

Exit status 2, with what is wrong, where they do not. It loads no more than it takes to list the devices.
"""

from __future__ import annotations

import sys

from opencl.device import DEVICE_VARIABLE, choose_device, list_devices


def main() -> int:
    try:
        choose_device()
    except ValueError as error:
        remedy = f". Set {DEVICE_VARIABLE} to one of these, or unset it for the default one." if list_devices() else ""
        print(f"{error}{remedy}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
