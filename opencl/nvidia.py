"""Which OpenCL device is torch's CUDA device, and what is missing where none is or torch has none."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import pyopencl
import torch

from opencl.cuda_driver import CudaDriver
from opencl.device import Device

_VENDOR = "nvidia"

MISSING_ICD = """\
NVIDIA's driver has a GPU that OpenCL does not see. Where libnvidia-opencl.so.1 is missing (ldconfig -p | grep
nvidia-opencl): in a container, start it with NVIDIA_DRIVER_CAPABILITIES=compute,utility; else install the driver's
OpenCL (Debian and Ubuntu: nvidia-opencl-icd or libnvidia-compute-<version of the driver>). Where it is there, and
OCL_ICD_VENDORS or OCL_ICD_FILENAMES is set: unset it, or name the library there, too, in a directory of your own:
  mkdir -p ~/opencl && echo libnvidia-opencl.so.1 > ~/opencl/nvidia.icd && export OCL_ICD_VENDORS=~/opencl
(where the OpenCL loader is Khronos' and not pyopencl's own: export OCL_ICD_FILENAMES=libnvidia-opencl.so.1)."""


def faults(seen: bool, asked: bool) -> list[str]:
    """What keeps torch's work from the NVIDIA GPU of this machine, and what helps.

    `seen` is whether OpenCL sees it, `asked` whether it is asked for by name: then tensors of the CPU are copied to it
    where torch has no CUDA. Nothing where torch works on it and OpenCL draws there, or torch on another maker's GPU.
    """
    with warnings.catch_warnings():  # of torch's, about what is told here
        warnings.simplefilter("ignore")
        available = torch.cuda.is_available()
        if (asked and not available) or (available and torch.version.cuda is None):
            return []
        of_torch = _fault_of_torch()
    return [*([of_torch] if of_torch else []), *([] if seen else [MISSING_ICD])]


def _fault_of_torch() -> str | None:
    """None where it works there."""
    if torch.version.cuda is None:
        return (
            f"This machine has an NVIDIA GPU, and torch {torch.__version__} is not built for CUDA: install one that "
            "is, as pytorch.org/get-started says."
        )
    try:
        torch.cuda.init()
    except RuntimeError as error:
        return (
            f"torch {torch.__version__}, built for CUDA {torch.version.cuda}, does not start on this machine's NVIDIA "
            f"GPU ({_first_line(error)}): install a newer driver, or a torch that is built for the CUDA of this one "
            "(nvidia-smi names it; pytorch.org/get-started)."
        )
    try:
        torch.zeros(1, device="cuda").add_(1).item()
    except RuntimeError as error:
        if "out of memory" in str(error):  # it works, and others use it at the moment
            return None
        return (
            f"torch {torch.__version__}, built for CUDA {torch.version.cuda}, computes nothing on this machine's "
            f"NVIDIA GPU ({_first_line(error)}): where it has no kernels for this GPU, install one that has "
            "(pytorch.org/get-started; for GPUs older than Turing, sm_75, one that is built for CUDA 12)."
        )
    return None


def _first_line(error: RuntimeError) -> str:
    return str(error).partition("\n")[0].rstrip(".")


def is_nvidia(device: Device) -> bool:
    """Whether NVIDIA's own OpenCL drives it."""
    return _VENDOR in device.handle.platform.name.lower()


def pci_location(device: Device) -> tuple[int, int, int] | None:
    """Domain, bus and device on the PCI bus of one of NVIDIA's devices; None where its driver does not tell."""
    information = pyopencl.device_info
    try:
        bus = device.handle.get_info(information.PCI_BUS_ID_NV)
        slot = device.handle.get_info(information.PCI_SLOT_ID_NV)
    except pyopencl.Error:
        return None
    try:
        domain = device.handle.get_info(information.PCI_DOMAIN_ID_NV)
    except pyopencl.Error:
        domain = 0  # drivers of before 2018 tell none, for machines with one
    return int(domain), int(bus), int(slot) >> 3  # of the slot the lower three bits are the function


def torch_device_of(device: Device, devices: Sequence[Device], driver: CudaDriver) -> torch.device | None:
    """Torch's CUDA device for one of OpenCL's devices; None where torch does not use it."""
    if torch.version.cuda is None or not is_nvidia(device):
        return None
    candidates = (torch.device("cuda", ordinal) for ordinal in range(torch.cuda.device_count()))
    return next((one for one in candidates if opencl_device_of(one, devices, driver) == device), None)


def opencl_device_of(tensor_device: torch.device, devices: Sequence[Device], driver: CudaDriver) -> Device | None:
    """OpenCL's device for one of torch's CUDA devices; None where OpenCL does not see it.

    That at its place on the PCI bus. Virtual GPUs and odd domains are told of differently: where OpenCL and torch each
    see one device alone, that is it.
    """
    of_nvidia = [device for device in devices if is_nvidia(device)]
    if len(of_nvidia) == torch.cuda.device_count() == 1:
        return of_nvidia[0]
    location = driver.pci_location(tensor_device.index or 0)
    return next((device for device in of_nvidia if pci_location(device) == location), None)
