"""A fake GPU, to test without a real one whether code keeps its tensors on one device.

A fake tensor holds a CPU tensor, on which every operation of torch is done. But torch takes it for a tensor of another
device, and what would fail on CUDA fails here: operations that mix it with CPU tensors, and reading it as a NumPy
array. What CUDA allows is allowed: copies between devices, single numbers on the CPU, and CPU tensors as indices.

torch then knows the device until the process ends, and may ask it for more than this. So call `pretend_gpu` only in a
process of its own, before anything else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

NAME = "pretended"
COPIES = {"aten::_to_copy", "aten::copy_"}
INDEXING = {"aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_"}
FUSED = "aten::_fused_"
"""Operations that need even single numbers on the device: fused Adam, for example, its step counts."""

available = hasattr(backend_registration, "_setup_privateuseone_for_python_backend")
"""Whether this version of torch supports devices written in Python."""


def pretend_gpu() -> torch.device:
    """Register the device with torch. Call this once per process."""

    class Module(backend_registration._DummyBackendModule):
        """What torch asks of a device besides tensors. Random numbers are drawn on the CPU."""

        def get_amp_supported_dtype(self) -> list[torch.dtype]:
            return [torch.bfloat16]

        def get_rng_state(self, device: torch.device | int) -> Tensor:
            return torch.zeros(0, dtype=torch.uint8)

        def set_rng_state(self, state: Tensor, device: torch.device | int) -> None:
            pass

    backend_registration._setup_privateuseone_for_python_backend(NAME, Module())
    for operation, kernel in (("empty_strided", _empty_strided), ("copy_", _copy)):
        _kernels.impl(operation, kernel, "PrivateUse1")
    return torch.device(NAME, 0)


_kernels = torch.library.Library("aten", "IMPL")
"""Kernels of the two operations that do not reach Python otherwise, when torch makes a tensor of Python numbers."""


def _empty_strided(size: list[int], stride: list[int], *, dtype: torch.dtype, **_: Any) -> Tensor:
    return PretendedTensor(torch.empty_strided(size, stride, dtype=dtype))


def _copy(target: PretendedTensor, source: Tensor, non_blocking: bool = False) -> Tensor:
    target.held.copy_(source)
    return target


class PretendedTensor(Tensor):
    """A tensor that claims to be on the fake device; its contents are in `held`."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> PretendedTensor:
        layout = {"strides": held.stride(), "storage_offset": held.storage_offset(), "dtype": held.dtype}
        tensor = torch.Tensor._make_wrapper_subclass(cls, held.shape, device=torch.device(NAME, 0), **layout)
        tensor.held = held
        return tensor

    @classmethod
    def __torch_dispatch__(cls, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _done(operation, args, kwargs or {})


class Pretending(TorchDispatchMode):
    """Also handles operations without fake arguments, which create tensors; records the operations of each device."""

    def __init__(self) -> None:
        super().__init__()
        self.on_device: set[str] = set()
        self.on_cpu: set[str] = set()

    def __torch_dispatch__(self, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        results = _done(operation, args, kwargs or {})
        there = any(isinstance(leaf, PretendedTensor) for leaf in tree_leaves((args, kwargs, results)))
        (self.on_device if there else self.on_cpu).add(operation._schema.name)
        return results


@contextmanager
def pretending() -> Iterator[Pretending]:
    """A context in which tensors can be created on the device and moved to it."""
    with Pretending() as mode:
        yield mode


def _done(operation: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """The operation's results, on the device named in its arguments, or otherwise on that of its tensors."""
    tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
    on_device = any(isinstance(tensor, PretendedTensor) for tensor in tensors)
    if on_device:
        _refuse_mixtures(operation, args, kwargs)
    if kwargs.get("device") is not None:
        on_device = torch.device(kwargs["device"]).type == NAME
        kwargs = kwargs | {"device": torch.device("cpu")}
    results = operation(*tree_map(_held, args), **tree_map(_held, kwargs))
    given = {id(_held(tensor)): tensor for tensor in tensors}
    return tree_map(_placing(on_device, given), results)


def _placing(on_device: bool, given: dict[int, Tensor]) -> Callable[[Any], Any]:
    def placed(result: Any) -> Any:
        if id(result) in given:
            return given[id(result)]  # changed in place
        return PretendedTensor(result) if on_device and isinstance(result, Tensor) else result

    return placed


def _held(value: Any) -> Any:
    return value.held if isinstance(value, PretendedTensor) else value


def _refuse_mixtures(operation: Any, args: Any, kwargs: dict[str, Any]) -> None:
    name = operation._schema.name
    if name in COPIES:
        return
    checked = (args[0], *args[2:], kwargs) if name in INDEXING else (args, kwargs)
    most = -1 if name.startswith(FUSED) else 0
    for tensor in tree_leaves(checked):
        if isinstance(tensor, Tensor) and not isinstance(tensor, PretendedTensor) and tensor.ndim > most:
            raise RuntimeError(f"{name}: found tensors on {NAME} and one of shape {tuple(tensor.shape)} on the CPU")
