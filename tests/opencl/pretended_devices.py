"""Fake OpenCL devices: GPUs on machines that have none."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import pyopencl

from opencl.device import Device


@dataclass(frozen=True)
class FakeHandle:
    """The part of a pyopencl.Device that is needed for choosing a device."""

    platform: SimpleNamespace = field(hash=False)
    name: str
    vendor: str
    type: int = pyopencl.device_type.GPU
    location: tuple[int, int, int] = (0, 65, 0)
    knows_domain: bool = True

    def get_info(self, what):
        domain, bus, slot = self.location
        information = pyopencl.device_info
        if what == information.PCI_DOMAIN_ID_NV and not self.knows_domain:
            raise pyopencl.LogicError("clGetDeviceInfo failed: INVALID_VALUE")
        return {
            information.PCI_DOMAIN_ID_NV: domain,
            information.PCI_BUS_ID_NV: bus,
            information.PCI_SLOT_ID_NV: slot << 3,
        }[what]


def gpu(maker="NVIDIA Corporation", platform="NVIDIA CUDA", index="1:0", **options) -> Device:
    handle = FakeHandle(SimpleNamespace(name=platform, version="OpenCL 3.0"), f"GPU of {maker}", maker, **options)
    return Device(index, handle)
