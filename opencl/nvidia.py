"""Matches OpenCL devices with torch's CUDA devices, and diagnoses what is missing if one side lacks the GPU."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

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

IN_WSL = """\
This is WSL 2, inside which NVIDIA offers CUDA but no OpenCL, which draws here: the GPU can be used from Linux alone.
Install no driver or library of NVIDIA's inside WSL: it would take the place of the one that Windows provides."""
_KERNEL = Path("/proc/version")


def faults(seen: bool, asked: bool) -> list[str]:
    """Reasons why torch cannot use this machine's NVIDIA GPU or OpenCL cannot draw on it, each with a remedy.

    `seen` states whether OpenCL sees the GPU, `asked` whether the user requested it by name. Empty if torch and OpenCL
    both work on it, if torch works on a GPU of another vendor, or if `asked` and CUDA is not available in torch: OpenCL
    then draws CPU tensors on the GPU, with copies.
    """
    with warnings.catch_warnings():  # torch warns of the faults that are reported here
        warnings.simplefilter("ignore")
        available = torch.cuda.is_available()
        if (asked and not available) or (available and torch.version.cuda is None):
            return []
        of_torch = _fault_of_torch()
    missing = [] if seen else [IN_WSL if _is_wsl() else MISSING_ICD]
    return [*([of_torch] if of_torch else []), *missing]


def _is_wsl() -> bool:
    """Whether this Linux runs inside Windows (WSL), whose kernel says so."""
    return _KERNEL.is_file() and "microsoft" in _KERNEL.read_text(errors="replace").lower()


def _fault_of_torch() -> str | None:
    """Why torch does not work on the NVIDIA GPU, with a remedy, or None if it does."""
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
        if "out of memory" in str(error):  # the GPU works, but others have taken its memory
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
    """Whether the device belongs to NVIDIA's own OpenCL platform."""
    return _VENDOR in device.handle.platform.name.lower()


def pci_location(device: Device) -> tuple[int, int, int] | None:
    """PCI domain, bus and device numbers of an NVIDIA device, or None if its driver does not report them."""
    information = pyopencl.device_info
    try:
        bus = device.handle.get_info(information.PCI_BUS_ID_NV)
        slot = device.handle.get_info(information.PCI_SLOT_ID_NV)
    except pyopencl.Error:
        return None
    try:
        domain = device.handle.get_info(information.PCI_DOMAIN_ID_NV)
    except pyopencl.Error:
        domain = 0  # drivers from before 2018 do not report it; 0 on machines with one domain
    return int(domain), int(bus), int(slot) >> 3  # the lower three bits of the slot are the function


def torch_device_of(device: Device, devices: Sequence[Device], driver: CudaDriver) -> torch.device | None:
    """Torch's CUDA device for an OpenCL device, or None if torch does not see it."""
    if torch.version.cuda is None or not is_nvidia(device):
        return None
    candidates = (torch.device("cuda", ordinal) for ordinal in range(torch.cuda.device_count()))
    return next((one for one in candidates if opencl_device_of(one, devices, driver) == device), None)


def opencl_device_of(tensor_device: torch.device, devices: Sequence[Device], driver: CudaDriver) -> Device | None:
    """OpenCL's device for one of torch's CUDA devices, or None if OpenCL does not see it.

    Devices are matched by their PCI locations. If OpenCL and torch each see exactly one, those two match regardless:
    the locations of virtual GPUs and unusual domains are reported differently.
    """
    of_nvidia = [device for device in devices if is_nvidia(device)]
    if len(of_nvidia) == torch.cuda.device_count() == 1:
        return of_nvidia[0]
    location = driver.pci_location(tensor_device.index or 0)
    return next((device for device in of_nvidia if pci_location(device) == location), None)
