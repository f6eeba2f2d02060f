"""Kernels on torch's CUDA tensors: compiled by NVIDIA's OpenCL, launched by the CUDA driver on torch's stream.

No tensor is copied. OpenCL compiles to PTX, which is loaded into torch's CUDA context, where torch's addresses are
valid. Kernels are launched on torch's current stream and so run in order with torch's own work. The host waits only for
the number of tile entries, which determines the size of the tile lists, and for a camera that is on the GPU.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import pyopencl
import torch
from torch import Tensor

from opencl.backend import Backend, Session
from opencl.cuda_driver import CudaDriver
from opencl.device import Device
from opencl.memory import TorchMemory
from opencl.program import ProgramKey
from opencl.ptx import CudaProgram, Parameter, rewrite_for_cuda

_CODES = {1: "b", 2: "h", 4: "i", 8: "Q"}
"""Format characters of `struct`, by size in bytes."""


class Arguments:
    """Memory from which the driver reads the arguments of a kernel.

    Allocated once and overwritten for each launch: the driver reads it before a launch returns.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        codes = [_CODES[parameter.size] for parameter in parameters]
        self._layout = struct.Struct("@" + "".join(codes))
        self._memory = ctypes.create_string_buffer(self._layout.size + 1)  # an empty buffer has no address
        ends = [struct.calcsize("@" + "".join(codes[: place + 1])) for place in range(len(codes))]
        begin = ctypes.addressof(self._memory)
        places = [begin + end - parameter.size for end, parameter in zip(ends, parameters, strict=True)]
        self.pointers = (ctypes.c_void_p * len(places))(*places)

    def write(self, values: Sequence[int]) -> None:
        self._layout.pack_into(self._memory, 0, *values)


@dataclass(frozen=True)
class CudaKernel:
    """A kernel that the driver has loaded."""

    function: int
    parameters: tuple[Parameter, ...]
    largest_group: int
    """Maximum number of work-items per group."""
    arguments: Arguments


@dataclass(frozen=True)
class Resources:
    """Resources that a kernel uses per work-item."""

    registers: int
    private_bytes: int
    """Local memory of CUDA, to which registers spill."""


_SLEEP_CYCLES = 200_000
"""GPU clock cycles, about 0.1 ms: longer than Python takes to queue a launch and the event after it."""


class LaunchTiming:
    """Start and end of a kernel, with the interface of an OpenCL event: `.profile.start`, `.profile.end`, nanoseconds.

    `stream` must be torch's current stream. Create the object just before the launch and call `stop` after it.
    """

    def __init__(self, stream: torch.cuda.Stream) -> None:
        self._stream = stream
        self._began, self._ended = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        # Otherwise an idle GPU would record the start at once, and Python's time until the launch would count.
        torch.cuda._sleep(_SLEEP_CYCLES)
        self._began.record(stream)

    def stop(self) -> None:
        self._ended.record(self._stream)

    def wait(self) -> None:
        self._ended.synchronize()

    @property
    def profile(self) -> LaunchTiming:
        self.wait()
        return self

    @property
    def start(self) -> int:
        """Always 0: times are relative to the start of the kernel."""
        return 0

    @property
    def end(self) -> int:
        return round(self._began.elapsed_time(self._ended) * 1e6)


class CudaSession(Session):
    """Launches kernels on torch's current stream. Tensors must be contiguous and on the backend's CUDA device."""

    torch_is_in_order = True

    def __init__(self, backend: CudaBackend) -> None:
        self._cuda = backend
        self.memory = backend.memory
        self._stream = torch.cuda.current_stream(backend.tensor_device)

    def launch(
        self, program: ProgramKey, kernel: str, groups: int, *arguments: Tensor | int, group_size: int = 1
    ) -> None:
        """Queue `groups` work-groups of a kernel. Integers are passed as int32, tensors as addresses (empty: null).

        Raises ValueError if the arguments do not match the kernel's parameters or the group is too large for it, and
        RuntimeError if the driver reports an error.
        """
        if groups == 0:
            return
        loaded = self._cuda.cuda_kernel(program, kernel)
        if group_size > loaded.largest_group:
            raise ValueError(
                f"kernel {kernel}: found groups of {group_size} work-items, expected at most {loaded.largest_group}, "
                "as its registers and local memory leave room for: compile it with less of either"
            )
        if len(arguments) != len(loaded.parameters):
            raise ValueError(f"kernel {kernel}: found {len(arguments)} arguments, expected {len(loaded.parameters)}")
        loaded.arguments.write(self._values(kernel, loaded.parameters, arguments))
        timing = LaunchTiming(self._stream) if self._cuda.profiled is not None else None
        pointers = loaded.arguments.pointers
        self._cuda.driver.launch(kernel, loaded.function, groups, group_size, self._stream.cuda_stream, pointers)
        if timing is not None and self._cuda.profiled is not None:
            timing.stop()
            self._cuda.profiled.append((kernel, timing))

    def _values(self, kernel: str, parameters: Sequence[Parameter], arguments: Sequence[Tensor | int]) -> list[int]:
        """Check the arguments. Returns integers unchanged, and tensors as addresses."""
        device = self._cuda.tensor_device
        values: list[int] = []
        for parameter, argument in zip(parameters, arguments, strict=True):
            fault = ""
            if isinstance(argument, int):
                value, size = argument, 4
                if not -(2**31) <= value < 2**31:
                    fault = f"{value}, expected a number of 32 bits"
            elif argument.device == device and argument.is_contiguous():
                value, size = argument.data_ptr() if argument.numel() else 0, 8
                if value % parameter.alignment:
                    fault = f"the address {value}, expected a multiple of {parameter.alignment}"
            else:
                where = f"on {argument.device} of strides {argument.stride()}"
                raise ValueError(
                    f"kernel {kernel}, argument {len(values)}: found a tensor {where}, expected a contiguous one on "
                    f"{device}"
                )
            if size != parameter.size:
                kind = "an integer" if isinstance(argument, int) else "a tensor"
                fault = f"{kind}, expected what takes {parameter.size} bytes"
            if fault:
                raise ValueError(f"kernel {kernel}, argument {len(values)}: found {fault}")
            values.append(value)
        return values

    def finish(self, *results: Tensor) -> None:
        """Do nothing: torch reads the results on the stream on which the kernels run."""

    def give(self, *results: Tensor) -> tuple[Tensor, ...]:
        """Return `results` themselves: torch reads them on the stream on which the kernels run."""
        return results


class CudaBackend(Backend):
    """An NVIDIA GPU whose kernels work in place on torch's CUDA tensors."""

    def __init__(
        self,
        device: Device,
        driver: CudaDriver,
        tensor_device: torch.device,
        profile: bool = False,
        compile_program: Callable[[ProgramKey], bytes] | None = None,
    ) -> None:
        """`device` is the OpenCL device of the same GPU as torch's `tensor_device`, which must have an index.

        `compile_program` returns a program's PTX. The default is NVIDIA's OpenCL compiler.
        """
        super().__init__(device, schedule="gpu", shares_memory=True, profile=profile)
        self.driver = driver
        self.memory = TorchMemory(tensor_device)
        self._compile = compile_program or self._ptx
        self._primary = driver.primary_context(tensor_device.index or 0)
        self._modules: dict[ProgramKey, tuple[int, CudaProgram]] = {}
        self._cuda_kernels: dict[tuple[ProgramKey, str], CudaKernel] = {}

    def _ptx(self, program: ProgramKey) -> bytes:
        (binary,) = self.build(program).get_info(pyopencl.program_info.BINARIES)
        return bytes(binary)

    @contextmanager
    def _launching(self) -> Iterator[Session]:
        # Without torch.cuda.device, torch's next allocation would switch to the context of its default GPU.
        with torch.cuda.device(self.tensor_device), self.driver.current(self._primary):
            yield CudaSession(self)

    def cuda_kernel(self, program: ProgramKey, name: str) -> CudaKernel:
        """The kernel `name` of a program, compiled and loaded on first use. Call it within a session."""
        kernel = self._cuda_kernels.get((program, name))
        if kernel is None:
            module, loaded = self._module(program)
            if name not in loaded.kernels:
                raise ValueError(f"kernel {name}: found no such kernel, expected one of {', '.join(loaded.kernels)}")
            function = self.driver.function(module, name)
            parameters, most = loaded.kernels[name], self.driver.largest_group(function)
            kernel = CudaKernel(function, parameters, most, Arguments(parameters))
            self._cuda_kernels[program, name] = kernel
        return kernel

    def resources(self) -> dict[str, Resources]:
        """Resources of each kernel loaded so far, by name. Of several kernels of one name, the last one loaded."""
        with self.driver.current(self._primary):
            return {
                name: Resources(self.driver.registers(kernel.function), self.driver.private_bytes(kernel.function))
                for (_, name), kernel in self._cuda_kernels.items()
            }

    def _module(self, program: ProgramKey) -> tuple[int, CudaProgram]:
        if program not in self._modules:
            rewritten = rewrite_for_cuda(self._compile(program), program.needs_exact_rounding)
            self._modules[program] = self.driver.load(rewritten.text), rewritten
        return self._modules[program]
