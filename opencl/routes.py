"""Selects the backend that draws a device's tensors with the fewest copies, and the best device for tensors."""

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
"""Vendors of GPUs, by torch's device type. "cuda" is AMD or NVIDIA, depending on how torch was built."""


def backend_for(tensor_device: torch.device) -> Backend:
    """This process's backend for tensors on a torch device.

    CPU tensors are drawn by the device that GS_HIDER_DEVICE names, or the default one. Tensors on a GPU are drawn by:

    - the GPU itself, without copies, if it is an NVIDIA GPU that OpenCL sees and torch's CUDA uses;
    - otherwise a GPU of the same vendor, with copies through pinned memory;
    - otherwise, or if GS_HIDER_DEVICE names another device, the same device as CPU tensors, with copies.
    """
    if tensor_device.type == "cpu":
        return default_backend()
    return _backend_for(os.environ.get(DEVICE_VARIABLE, ""), tensor_device)


def works_in_place(tensor_device: torch.device) -> bool:
    """Whether tensors of this device are on the CPU, and an OpenCL device works in place on CPU memory.

    That device is the one of `backend_in_place`, whichever device draws. False if OpenCL has no device at all. Raises
    ValueError if GS_HIDER_DEVICE names none of its devices.
    """
    return tensor_device.type == "cpu" and _device_in_place(os.environ.get(DEVICE_VARIABLE, "")) is not None


def backend_in_place() -> Backend:
    """This process's backend for kernels that exist only for the CPU and work in place on CPU tensors.

    This is `default_backend` if it works in place, and otherwise a backend on the newest PoCL. Raises ValueError if
    there is neither (see `works_in_place`).
    """
    return _backend_in_place(os.environ.get(DEVICE_VARIABLE, ""))


@functools.cache
def _backend_in_place(setting: str) -> Backend:
    """`backend_in_place` while GS_HIDER_DEVICE is `setting`, the key of the cache."""
    device = _device_in_place(setting)
    if device is None:
        raise ValueError("no OpenCL device works in the CPU's memory: pip install 'pyopencl[pocl]'")
    return default_backend() if device == choose_device() else Backend(device)


@functools.cache
def _device_in_place(setting: str) -> Device | None:
    """The device of `backend_in_place`, or None. Found without creating a backend, which on a GPU would take memory."""
    if not list_devices():
        return None
    chosen = choose_device()
    if chosen.shares_memory:
        return chosen
    preferred = choose_device("")
    return preferred if preferred.shares_memory and _can_be_built_for(preferred) else None


def _can_be_built_for(device: Device) -> bool:
    """Whether kernels can be built for the device. If not, the user may have chosen another one for this reason."""
    try:
        device.prepare()
    except ValueError:
        return False
    return True


@functools.cache
def _backend_for(setting: str, tensor_device: torch.device) -> Backend:
    """`backend_for` a GPU's tensors while GS_HIDER_DEVICE is `setting`, a key of the cache."""
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
    """The best device for all tensors of a program that draws: torch's current CUDA device if there is one, or the CPU.

    If GS_HIDER_DEVICE is set, this is CUDA only if it names the GPU on which `backend_for` draws CUDA tensors: a user
    who selects PoCL wants the CPU to do all the work. Cameras may stay on the CPU. If CUDA is returned, its results
    have the same bits each time for the rest of this process (see `opencl.repeatable`).
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
    """The OpenCL device that draws tensors of this device, and whether these are copied: for provenance records."""
    backend = backend_for(tensor_device)
    copied = tensor_device.type != "cpu" and backend.tensor_device != tensor_device
    return f"{backend.device.describe()}{f', tensors copied from {tensor_device}' if copied else ''}"


def cuda_driver() -> CudaDriver | None:
    """The driver of torch's CUDA devices, or None if torch has no NVIDIA GPU."""
    return load_driver() if torch.version.cuda is not None and torch.cuda.is_available() else None


def _own_device(tensor_device: torch.device, driver: CudaDriver | None) -> Device | None:
    """The OpenCL device of the same GPU, or another GPU of the same vendor, or None."""
    devices = list_devices()
    if driver is not None:
        return opencl_device_of(tensor_device, devices, driver) or next(filter(is_nvidia, devices), None)
    maker = _VENDORS.get(tensor_device.type, "advanced micro devices")
    return next((device for device in devices if _is_gpu(device) and maker in device.handle.vendor.lower()), None)


def _is_gpu(device: Device) -> bool:
    return bool(device.handle.type & pyopencl.device_type.GPU)


def describe_route(device: Device) -> str:
    """A short text on how this device's kernels access torch tensors."""
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
    """Advice on what to install, for each kind of device that this machine has but OpenCL does not see."""
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
