"""Checked calls of the few functions of the CUDA driver (libcuda) that load programs and launch kernels."""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from ctypes import POINTER, c_char_p, c_int, c_uint, c_void_p

_HANDLE = POINTER(c_void_p)

PROTOTYPES: dict[str, tuple[type, ...]] = {
    "cuInit": (c_uint,),
    "cuGetErrorName": (c_int, POINTER(c_char_p)),
    "cuGetErrorString": (c_int, POINTER(c_char_p)),
    "cuDeviceGet": (POINTER(c_int), c_int),
    "cuDeviceGetAttribute": (POINTER(c_int), c_int, c_int),
    "cuDevicePrimaryCtxRetain": (_HANDLE, c_int),
    "cuCtxPushCurrent_v2": (c_void_p,),
    "cuCtxPopCurrent_v2": (_HANDLE,),
    "cuModuleLoadDataEx": (_HANDLE, c_void_p, c_uint, POINTER(c_int), _HANDLE),
    "cuModuleGetFunction": (_HANDLE, c_void_p, c_char_p),
    "cuFuncGetAttribute": (POINTER(c_int), c_int, c_void_p),
    "cuLaunchKernel": (c_void_p, *(c_uint,) * 6, c_uint, c_void_p, _HANDLE, _HANDLE),
}
"""Argument types of each function, as in cuda.h. Each returns a CUresult, an int."""

_PCI_BUS, _PCI_DEVICE, _PCI_DOMAIN = 33, 34, 50  # of CUdevice_attribute
_LARGEST_GROUP, _PRIVATE_BYTES, _REGISTERS = 0, 3, 4  # of CUfunction_attribute
_ERROR_LOG, _ERROR_LOG_SIZE = 5, 6  # of CUjit_option
_LOG_BYTES = 16384

Function = Callable[..., int]


class CudaDriver:
    """The CUDA driver. Every error raises a RuntimeError with the driver's own name and description of it."""

    def __init__(self, functions: Mapping[str, Function]) -> None:
        """`functions` are the ctypes functions listed in `PROTOTYPES`, by name."""
        self._functions = functions
        self._call("cuInit", "", 0)

    def _call(self, function: str, where: str, *arguments: object) -> None:
        status = self._functions[function](*arguments)
        if status:
            name, text = (self._describe(one, status) for one in ("cuGetErrorName", "cuGetErrorString"))
            raise RuntimeError(f"{function}{where}: {name} ({status}): {text}")

    def _describe(self, function: str, status: int) -> str:
        text = c_char_p()
        self._functions[function](status, ctypes.byref(text))
        return text.value.decode(errors="replace") if text.value else "an error that the driver does not know"

    def device(self, ordinal: int) -> int:
        """The handle of a device. Ordinals are the same as torch's: both count the devices in CUDA_VISIBLE_DEVICES."""
        device = c_int()
        self._call("cuDeviceGet", f" of device {ordinal}", ctypes.byref(device), ordinal)
        return device.value

    def pci_location(self, ordinal: int) -> tuple[int, int, int]:
        """PCI domain, bus and device numbers."""
        device, value = self.device(ordinal), c_int()
        numbers = []
        for attribute in (_PCI_DOMAIN, _PCI_BUS, _PCI_DEVICE):
            self._call("cuDeviceGetAttribute", f" of device {ordinal}", ctypes.byref(value), attribute, device)
            numbers.append(value.value)
        domain, bus, slot = numbers
        return domain, bus, slot

    def primary_context(self, ordinal: int) -> int:
        """The device's primary context, which torch uses. It is retained until the process ends."""
        context = c_void_p()
        where = f" of device {ordinal}"
        self._call("cuDevicePrimaryCtxRetain", where, ctypes.byref(context), self.device(ordinal))
        return _given(context)

    @contextmanager
    def current(self, context: int) -> Iterator[None]:
        """Make the context current in this thread, as autograd runs backward passes in threads of its own."""
        self._call("cuCtxPushCurrent_v2", "", context)
        try:
            yield
        finally:
            self._call("cuCtxPopCurrent_v2", "", ctypes.byref(c_void_p()))

    def load(self, text: str) -> int:
        """Load PTX into the current context. Returns the module, which stays loaded until the process ends."""
        image, log = ctypes.create_string_buffer(text.encode()), ctypes.create_string_buffer(_LOG_BYTES)
        options = (c_int * 2)(_ERROR_LOG, _ERROR_LOG_SIZE)
        values = (c_void_p * 2)(ctypes.addressof(log), _LOG_BYTES)
        module = c_void_p()
        try:
            self._call("cuModuleLoadDataEx", "", ctypes.byref(module), image, 2, options, values)
        except RuntimeError as error:
            said = log.value.decode(errors="replace").strip() or "nothing"
            raise RuntimeError(f"{error}; the driver's assembler said: {said}") from None
        return _given(module)

    def function(self, module: int, kernel: str) -> int:
        function = c_void_p()
        self._call("cuModuleGetFunction", f" of kernel {kernel}", ctypes.byref(function), module, kernel.encode())
        return _given(function)

    def largest_group(self, function: int) -> int:
        """Maximum work-items per group of this kernel, as limited by its registers and local memory."""
        return self._attribute(function, _LARGEST_GROUP)

    def registers(self, function: int) -> int:
        """Registers per work-item."""
        return self._attribute(function, _REGISTERS)

    def private_bytes(self, function: int) -> int:
        """Bytes per work-item that registers spill to memory: slow, ideally 0."""
        return self._attribute(function, _PRIVATE_BYTES)

    def _attribute(self, function: int, number: int) -> int:
        value = c_int()
        self._call("cuFuncGetAttribute", "", ctypes.byref(value), number, function)
        return value.value

    def launch(
        self,
        kernel: str,
        function: int,
        groups: int,
        group_size: int,
        stream: int,
        arguments: ctypes.Array[c_void_p],
    ) -> None:
        """Queue a one-dimensional launch on a stream. The driver reads all arguments before this returns."""
        where = f" of kernel {kernel} with {groups} groups of {group_size} work-items and {len(arguments)} arguments"
        # The last 0: kernels declare their local memory themselves.
        shape = (groups, 1, 1, group_size, 1, 1, 0)
        self._call("cuLaunchKernel", where, function, *shape, stream, arguments, None)


def _given(handle: c_void_p) -> int:
    if handle.value is None:
        raise RuntimeError("the CUDA driver reported success and gave a null handle: it is broken, install another")
    return handle.value


@functools.cache
def load_driver() -> CudaDriver | None:
    """The CUDA driver of this machine, or None without one. Raises RuntimeError if it does not start."""
    try:
        library = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        functions = {name: getattr(library, name) for name in PROTOTYPES}
    except (OSError, AttributeError):
        return None
    for name, arguments in PROTOTYPES.items():
        functions[name].argtypes, functions[name].restype = arguments, c_int
    return CudaDriver(functions)
