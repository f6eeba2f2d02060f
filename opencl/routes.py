"""Which backend draws tensors of a device, by the fewest copies, and on which device tensors are best kept."""

from __future__ import annotations

import functools
import os
import warnings

import pyopencl
import torch

from opencl.backend import Backend, default_backend
from opencl.cuda import CudaBackend
from opencl.cuda_driver import CudaDriver, load_driver
from opencl.device import DEVICE_VARIABLE, Device, choose_device, list_devices
from opencl.nvidia import MISSING_ICD, is_nvidia, opencl_device_of, torch_device_of
from opencl.repeatable import ask_for_the_same_bits

_VENDORS = {"xpu": "intel", "mps": "apple"}
"""Makers of GPUs, by torch's name for the kind of device; "cuda" is AMD's or NVIDIA's, as torch was built."""


def backend_for(tensor_device: torch.device) -> Backend:
    """This process's backend for tensors on a device of torch's.

    For the CPU's: the device that GS_HIDER_DEVICE names, or else the default one. For a GPU's: the GPU itself, without
    copies where NVIDIA's OpenCL drives it and torch's CUDA owns it; else a GPU of the same maker, with copies through
    pinned memory; else as for the CPU. Where GS_HIDER_DEVICE names none of these, the device it names, with copies.
    """
    if tensor_device.type == "cpu":
        return default_backend()
    return _backend_for(os.environ.get(DEVICE_VARIABLE, ""), tensor_device)


def works_in_place(tensor_device: torch.device) -> bool:
    """Whether tensors of this device are the CPU's, and OpenCL has a device that works in their own memory.

    Such is `backend_in_place`'s, whatever device draws. Not where OpenCL has no device at all. Raises ValueError where
    GS_HIDER_DEVICE names none of those that it has.
    """
    return tensor_device.type == "cpu" and _device_in_place(os.environ.get(DEVICE_VARIABLE, "")) is not None


def backend_in_place() -> Backend:
    """This process's backend for what only the CPU's kernels do, in the memory of its tensors.

    `default_backend` where that is one, else that of the newest PoCL. Raises ValueError where there is none, as
    `works_in_place` says.
    """
    return _backend_in_place(os.environ.get(DEVICE_VARIABLE, ""))


@functools.cache
def _backend_in_place(setting: str) -> Backend:
    """While GS_HIDER_DEVICE is `setting`."""
    device = _device_in_place(setting)
    if device is None:
        raise ValueError("no OpenCL device works in the CPU's memory: pip install 'pyopencl[pocl]'")
    return default_backend() if device == choose_device() else Backend(device)


@functools.cache
def _device_in_place(setting: str) -> Device | None:
    """While GS_HIDER_DEVICE is `setting`. A backend is not made for it: on a GPU it would take some of its memory."""
    if not list_devices():
        return None
    chosen = choose_device()
    if chosen.shares_memory:
        return chosen
    preferred = choose_device("")
    return preferred if preferred.shares_memory and _can_be_built_for(preferred) else None


def _can_be_built_for(device: Device) -> bool:
    """Whoever chose another device may have done so since this one is of no use here."""
    try:
        device.prepare()
    except ValueError:
        return False
    return True


@functools.cache
def _backend_for(setting: str, tensor_device: torch.device) -> Backend:
    """The backend while GS_HIDER_DEVICE is `setting`."""
    driver = cuda_driver() if tensor_device.type == "cuda" else None
    own = _own_device(tensor_device, driver)
    if own is None or not own.answers_to(setting):
        if not setting:
            lacking = " ".join(missing_pieces(list_devices()))
            warnings.warn(f"{tensor_device}: drawn elsewhere, with copies. {lacking}".strip(), stacklevel=2)
        return default_backend()
    if driver is not None and torch_device_of(own, list_devices(), driver) == tensor_device:
        torch.cuda.init()
        return CudaBackend(own, driver, tensor_device)
    if driver is not None:
        warnings.warn(
            f"{tensor_device}: drawn on {own.name} ({own.index}), with copies: OpenCL names no device at its place on "
            "the PCI bus",
            stacklevel=2,
        )
    return Backend(own)


def working_device() -> torch.device:
    """Where who draws had best keep all tensors: on torch's current CUDA device where there is one, else on the CPU.

    With GS_HIDER_DEVICE on CUDA only where it names what `backend_for` draws that device's tensors on as a GPU: who
    asks for PoCL wants the CPU to do all of it. Cameras may stay on the CPU. From then on this process's CUDA gives
    the same bits each time (`repeatable`).
    """
    if not torch.cuda.is_available():
        return torch.device("cpu")
    tensor_device = torch.device("cuda", torch.cuda.current_device())
    setting = os.environ.get(DEVICE_VARIABLE, "")
    own = _own_device(tensor_device, cuda_driver()) if setting else None
    if setting and (own is None or not own.answers_to(setting)):
        return torch.device("cpu")
    ask_for_the_same_bits()
    return tensor_device


def describe_drawing(tensor_device: torch.device) -> str:
    """The OpenCL device that draws tensors of this device, and where these are if not on it: for provenance records."""
    backend = backend_for(tensor_device)
    copied = tensor_device.type != "cpu" and backend.tensor_device != tensor_device
    return f"{backend.device.describe()}{f', tensors copied from {tensor_device}' if copied else ''}"


def cuda_driver() -> CudaDriver | None:
    """The driver of torch's CUDA devices; None where torch has none (of NVIDIA's)."""
    return load_driver() if torch.version.cuda is not None and torch.cuda.is_available() else None


def _own_device(tensor_device: torch.device, driver: CudaDriver | None) -> Device | None:
    """OpenCL's device for torch's, or else another of the same maker; None where there is none."""
    devices = list_devices()
    if driver is not None:
        return opencl_device_of(tensor_device, devices, driver) or next(filter(is_nvidia, devices), None)
    maker = _VENDORS.get(tensor_device.type, "advanced micro devices")
    return next((device for device in devices if _is_gpu(device) and maker in device.handle.vendor.lower()), None)


def _is_gpu(device: Device) -> bool:
    return bool(device.handle.type & pyopencl.device_type.GPU)


def describe_route(device: Device) -> str:
    """How kernels of this device reach torch's tensors, in a few words."""
    if device.shares_memory:
        return "cpu schedule, works in torch's memory"
    driver = cuda_driver()
    owner = torch_device_of(device, list_devices(), driver) if driver is not None else None
    if owner is not None:
        return f"gpu schedule, works in torch's memory on {owner} (PTX); CPU tensors by copies through pinned memory"
    copies = f"{'cpu' if device.is_cpu else 'gpu'} schedule, copies through pinned memory"
    if is_nvidia(device):
        return f"{copies}; without copies with a torch that is built for CUDA (pytorch.org/get-started)"
    return copies


def missing_pieces(devices: list[Device]) -> list[str]:
    """What to install for what this machine has and OpenCL does not see."""
    pieces = []
    if cuda_driver() is not None and not any(map(is_nvidia, devices)):
        pieces.append(MISSING_ICD)
    if not any(device.is_cpu for device in devices):
        pieces.append("No OpenCL for the CPU: pip install 'pyopencl[pocl]'")
    if torch.version.hip is not None and torch.cuda.is_available() and not any(map(_is_gpu, devices)):
        pieces.append("torch sees an AMD GPU, OpenCL sees none: install ROCm's OpenCL (rocm-opencl-runtime)")
    if getattr(torch, "xpu", None) is not None and torch.xpu.is_available() and not any(map(_is_gpu, devices)):
        pieces.append("torch sees an Intel GPU, OpenCL sees none: install Intel's compute runtime (intel-opencl-icd)")
    return pieces
