"""Rewrites PTX from NVIDIA's OpenCL compiler for the CUDA driver.

The text comes from CL_PROGRAM_BINARIES. Three things in it are specific to OpenCL: attributes of pointer parameters,
the texture mode of the target, and the `%envreg` registers, in which OpenCL passes the offset and size of the launch to
the kernel. CUDA launches leave these registers undefined. As our launches start at 0, offsets become the constant 0,
and counts become those of the grid.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_ENVIRONMENT = {
    **dict.fromkeys(("%envreg0", "%envreg1", "%envreg2"), "0"),  # first group of the launch
    **dict.fromkeys(("%envreg3", "%envreg4", "%envreg5"), "0"),  # get_global_offset
    "%envreg6": "%nctaid.x",  # get_num_groups
    "%envreg7": "%nctaid.y",
    "%envreg8": "%nctaid.z",
}
_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}

_STRING_OR_COMMENT = re.compile(r'("[^"\n]*")|//[^\n]*|/\*.*?\*/', re.DOTALL)
_TARGET = re.compile(r"^(\s*\.target\s[^\n]*?)\s*,\s*texmode_independent\b", re.MULTILINE)
_ENTRY = re.compile(r"(?:\.visible\s+)?\.entry\s+(?P<name>[\w$%]+)\s*(?:\((?P<parameters>[^)]*)\))?")
_FUNCTION = re.compile(r"\.(?:entry|func)\s+(?:\([^)]*\)\s*)?([\w$%]+)")
_POINTER = re.compile(r"\s*\.ptr\b(?P<space>\s*\.(?:global|const|local|shared))?(?:\s*\.align\s+(?P<alignment>\d+))?")
_SCALAR = re.compile(r"\s*\.param\s+\.[subf](?P<bits>8|16|32|64)\s+[\w$%]+\s*")
_ENVIRONMENT_REGISTER = re.compile(r"(?:\bmov\.[bus]32(?P<target>\s+%[\w$]+\s*,\s*))?(?P<register>%envreg\d+)\b")
_UNROUNDED = re.compile(r"(?<![\w$%.])(add|sub|mul)(?=(?:\.ftz)?(?:\.sat)?\.f(?:32|64|32x2)\b)")


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kernel."""

    size: int
    """Bytes: 8 for a pointer, 4 for an int."""
    alignment: int = 1
    """Required alignment in bytes of the address in a pointer; 1 for others."""


@dataclass(frozen=True)
class CudaProgram:
    """A program that the CUDA driver can load."""

    text: str
    kernels: dict[str, tuple[Parameter, ...]]
    """Parameters of each kernel, in order."""


def rewrite_for_cuda(binary: bytes, exact_rounding: bool = False) -> CudaProgram:
    """Rewrite the PTX in a device's binary. Kernels may use all of OpenCL but offsets, images and `__local` arguments.

    With `exact_rounding`, each product, sum and difference gets a rounding mode. Without one, the driver's assembler
    may contract two operations to an fma, even if FP_CONTRACT is off in the compiler.

    Raises ValueError if the binary is not PTX or has no kernel, or if a kernel needs something that a CUDA launch does
    not provide.
    """
    text = _decode(binary)
    text = _STRING_OR_COMMENT.sub(lambda found: found[1] or " ", text)
    text = _TARGET.sub(r"\1", text)
    text = _replace_environment(text)
    if exact_rounding:
        text = _UNROUNDED.sub(r"\1.rn", text)
    kernels: dict[str, tuple[Parameter, ...]] = {}

    def rewrite_entry(found: re.Match[str]) -> str:
        name, written = found["name"], (found["parameters"] or "").strip()
        parameters = [_parameter(name, one) for one in written.split(",")] if written else []
        kernels[name] = tuple(parameters)
        return f".visible .entry {name}({_POINTER.sub('', found['parameters'] or '')})"

    text = _ENTRY.sub(rewrite_entry, text)
    if not kernels:
        raise ValueError("PTX of NVIDIA's OpenCL compiler: found no .entry, expected one for each kernel")
    return CudaProgram(text, kernels)


def _decode(binary: bytes) -> str:
    text = binary.rstrip(b"\0")
    if b"\0" in text or b".version" not in text:
        raise ValueError(
            f"binary of NVIDIA's OpenCL compiler: found {len(binary)} bytes ({binary[:16].hex(' ')}), expected PTX "
            "text; with this driver, draw tensors of the CPU instead: they are copied to the GPU"
        )
    return text.decode("utf-8", errors="replace")


def _parameter(kernel: str, written: str) -> Parameter:
    pointer = _POINTER.search(written)
    if pointer and (pointer["space"] or "").strip() in (".shared", ".local"):
        raise ValueError(
            f"kernel {kernel}: found the parameter {written.strip()!r}, expected no local memory among the arguments: "
            "declare it inside the kernel"
        )
    scalar = _SCALAR.fullmatch(_POINTER.sub("", written))
    if scalar is None:
        raise ValueError(f"kernel {kernel}: found the parameter {written.strip()!r}, expected a pointer or a number")
    return Parameter(_BYTES[scalar["bits"]], int(pointer["alignment"] or 1) if pointer else 1)


def _replace_environment(text: str) -> str:
    """Replace `%envreg` registers by their values. PTX reads special registers with mov.u32."""

    def written_out(found: re.Match[str]) -> str:
        value = _ENVIRONMENT.get(found["register"])
        if value is None:
            kernel = [one[1] for one in _FUNCTION.finditer(text, 0, found.start())][-1:] or ["before any kernel"]
            raise ValueError(
                f"kernel {kernel[0]}: found the register {found['register']}, whose meaning is not known here, "
                f"expected only {', '.join(_ENVIRONMENT)}: write the kernel without what reads it"
            )
        return f"mov.u32{found['target']}{value}" if found["target"] else value

    return _ENVIRONMENT_REGISTER.sub(written_out, text)
