"""Kernels on torch's CUDA tensors: compiled by NVIDIA's OpenCL, launched by the CUDA driver on torch's stream.

Nothing is copied. OpenCL gives the PTX; it is loaded into the context that torch works in, so that torch's addresses
are valid in it, and launched on torch's current stream, so that kernels run after what torch queued before and before
what it queues after. Nobody waits but for the one number that torch reads to make room for the tiles' lists, and for a
camera that lies on the GPU.
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
"""How `struct` calls what takes so many bytes."""


class Arguments:
    """Where the driver reads a kernel's arguments at each launch, before that returns: made once, written each time."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        codes = [_CODES[parameter.size] for parameter in parameters]
        self._layout = struct.Struct("@" + "".join(codes))
        self._memory = ctypes.create_string_buffer(self._layout.size + 1)  # one without a byte has no address
        ends = [struct.calcsize("@" + "".join(codes[: place + 1])) for place in range(len(codes))]
        begin = ctypes.addressof(self._memory)
        places = [begin + end - parameter.size for end, parameter in zip(ends, parameters, strict=True)]
        self.pointers = (ctypes.c_void_p * len(places))(*places)

    def write(self, values: Sequence[int]) -> None:
        self._layout.pack_into(self._memory, 0, *values)


@dataclass(frozen=True)
class CudaKernel:
    """A kernel as the driver knows it."""

    function: int
    parameters: tuple[Parameter, ...]
    largest_group: int
    """Work-items that a group may have."""
    arguments: Arguments


@dataclass(frozen=True)
class Resources:
    """What a kernel takes for each work-item."""

    registers: int
    private_bytes: int
    """Memory for what the registers do not hold."""


_SLEEP_CYCLES = 200_000
"""Of the GPU's clock, about 0.1 ms: Python takes less to queue a launch and what is recorded after it."""


class LaunchTiming:
    """When a kernel began and ended, read as that of an OpenCL event: `.profile.start`, `.profile.end`, nanoseconds.

    Made where the stream that kernels are launched on is torch's current one.
    """

    def __init__(self, stream: torch.cuda.Stream) -> None:
        self._stream = stream
        self._began, self._ended = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        # Or else an idle GPU would note the beginning at once, and the time would be Python's until the launch.
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
        """Counted from the kernel's own beginning."""
        return 0

    @property
    def end(self) -> int:
        return round(self._began.elapsed_time(self._ended) * 1e6)


class CudaSession(Session):
    """Launches in order on torch's current stream. Tensors are contiguous, on the backend's CUDA device."""

    torch_is_in_order = True

    def __init__(self, backend: CudaBackend) -> None:
        self._cuda = backend
        self.memory = backend.memory
        self._stream = torch.cuda.current_stream(backend.tensor_device)

    def launch(
        self, program: ProgramKey, kernel: str, groups: int, *arguments: Tensor | int, group_size: int = 1
    ) -> None:
        """Queue `groups` work-groups of a kernel; integers are passed as int32, tensors as addresses (empty: null).

        `ValueError` for arguments that are not what the kernel was compiled for, `RuntimeError` where the driver
        refuses.
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
        """Numbers as they are, tensors as addresses."""
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
        """Nothing to wait for: torch reads them on the stream that the kernels are on."""

    def give(self, *results: Tensor) -> tuple[Tensor, ...]:
        """The results themselves; torch reads them on the stream that the kernels are on."""
        return results


class CudaBackend(Backend):
    """An NVIDIA GPU on whose tensors in torch's memory the kernels work."""

    def __init__(
        self,
        device: Device,
        driver: CudaDriver,
        tensor_device: torch.device,
        profile: bool = False,
        compile_program: Callable[[ProgramKey], bytes] | None = None,
    ) -> None:
        """`device` is OpenCL's name for torch's `tensor_device`, which has an index.

        `compile_program` gives a program's PTX; None: NVIDIA's OpenCL does.
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
        # Without the first, torch's next allocation would make another GPU's context current where that is its default.
        with torch.cuda.device(self.tensor_device), self.driver.current(self._primary):
            yield CudaSession(self)

    def cuda_kernel(self, program: ProgramKey, name: str) -> CudaKernel:
        """A kernel, built and loaded on first use, within a session."""
        kernel = self._cuda_kernels.get((program, name))
        if kernel is None:
            module, loaded = self._module(program)
            if name not in loaded.kernels:
                raise ValueError(f"kernel {name}: found none of this name, expected one of {', '.join(loaded.kernels)}")
            function = self.driver.function(module, name)
            parameters, most = loaded.kernels[name], self.driver.largest_group(function)
            kernel = CudaKernel(function, parameters, most, Arguments(parameters))
            self._cuda_kernels[program, name] = kernel
        return kernel

    def resources(self) -> dict[str, Resources]:
        """Of each kernel that was launched so far, by its name; of several by one name, those of the last."""
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
