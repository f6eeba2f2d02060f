"""PTX as NVIDIA's OpenCL compiler writes it, rewritten for the CUDA driver."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from opencl.ptx import Parameter, rewrite_for_cuda

PTX = Path(__file__).parent / "ptx"
TEXTS = sorted(PTX.glob("*.ptx"))


def instructions(text: str) -> list[str]:
    """The lines of a PTX text without comments, with whitespace normalised."""
    lines = (re.sub(r"//.*|/\*.*?\*/", "", line) for line in text.splitlines())
    return [" ".join(line.split()) for line in lines if line.strip()]


def kernel(body: str = "ret;", parameters: str = "", name: str = "draw") -> bytes:
    return f".version 8.7\n.target sm_90\n.address_size 64\n.entry {name}({parameters})\n{{ {body} }}\n".encode()


def test_only_what_is_opencl_s_own_changes():
    before = (PTX / "elementwise.ptx").read_text()
    after = instructions(rewrite_for_cuda(before.encode()).text)
    changed = {
        ".target sm_90, texmode_independent": ".target sm_90",
        ".entry scale(": ".visible .entry scale(",
        ".param .u64 .ptr .global .align 4 scale_param_1,": ".param .u64 scale_param_1,",
        ".param .u64 .ptr .global .align 4 scale_param_2": ".param .u64 scale_param_2",
        "mov.b32 %r3, %envreg3;": "mov.u32 %r3, 0;",
    }
    expected = [changed.pop(line, line) for line in instructions(before)]
    assert not changed
    assert after == expected


def test_offsets_are_zero_and_counts_are_the_grid_s():
    text = rewrite_for_cuda((PTX / "groups.ptx").read_bytes()).text
    assert "mov.u32\t%r10, %nctaid.x;" in text
    assert "mov.u32\t%r6, 0;" in text
    assert "mov.u32\t%r1, 0;" in text
    assert "envreg" not in text


def test_group_sizes_and_local_memory_stay():
    text = rewrite_for_cuda((PTX / "groups.ptx").read_bytes()).text
    assert ".reqntid 256, 1, 1" in text
    assert ".shared .align 8 .b8 sum_groups_$_partial[2048];" in text


def test_parameters_of_every_kernel():
    kernels = rewrite_for_cuda((PTX / "groups.ptx").read_bytes()).kernels
    assert kernels == {
        "sum_groups": (Parameter(4), Parameter(8, 8), Parameter(8, 8)),
        "group_of_each": (Parameter(8, 4),),
    }
    assert rewrite_for_cuda(kernel()).kernels == {"draw": ()}
    assert rewrite_for_cuda(kernel().replace(b"()", b"")).kernels == {"draw": ()}


@pytest.mark.parametrize(
    ("parameter", "size"),
    [(".param .u32 a", 4), (".param .f64 a", 8), (".param .u8 a", 1), (".param .u64 .ptr a", 8)],
)
def test_kinds_of_parameters(parameter, size):
    program = rewrite_for_cuda(kernel(parameters=parameter))
    assert program.kernels["draw"] == (Parameter(size),)
    assert ".ptr" not in program.text


def test_trailing_zeros_and_remarks_do_not_matter():
    binary = kernel("// %envreg31\n /* .entry other( \n %envreg30 */ ret;") + b"\0\0"
    assert set(rewrite_for_cuda(binary).kernels) == {"draw"}


def test_a_string_is_no_remark():
    binary = kernel().replace(b".address_size", b'.file 1 "//kernels"\n.address_size')
    assert '.file 1 "//kernels"' in rewrite_for_cuda(binary).text


def test_a_register_of_unknown_meaning_is_named_with_its_kernel():
    binary = kernel(name="first") + b".entry second()\n{ .reg .b32 %r<2>; mov.b32 %r1, %envreg9; }\n" + kernel()
    with pytest.raises(ValueError, match="kernel second: found the register %envreg9"):
        rewrite_for_cuda(binary)
    with pytest.raises(ValueError, match="%envreg30"):
        rewrite_for_cuda(kernel("add.s32 %r1, %r2, %envreg30;"))


ROUNDED = {
    "mul.f32 %f3, %f1, %f2;": "mul.rn.f32 %f3, %f1, %f2;",
    "@%p1 add.f64 %fd3, %fd1, %fd2;": "@%p1 add.rn.f64 %fd3, %fd1, %fd2;",
    "sub.ftz.sat.f32 %f3, %f1, %f2;": "sub.rn.ftz.sat.f32 %f3, %f1, %f2;",
    "add.f32x2 %rd3, %rd1, %rd2;": "add.rn.f32x2 %rd3, %rd1, %rd2;",
}
AS_THEY_WERE = (
    *("fma.rn.f32 %f4, %f1, %f2, %f3;", "mul.rz.f32 %f3, %f1, %f2;", "mul.rn.f64 %fd3, %fd1, %fd2;"),
    *(
        "mul.wide.s32 %rd3, %r1, 4;",
        "mad.lo.s32 %r6, %r4, %r5, %r3;",
        "add.s64 %rd5, %rd2, %rd3;",
        "sub.s32 %r1, %r2, 1;",
    ),
    *("div.rn.f32 %f3, %f1, %f2;", "atom.global.add.f32 %f1, [%rd1], %f2;"),
)


def test_products_and_sums_are_rounded_one_by_one_where_that_matters():
    body = "\n".join([*ROUNDED, *AS_THEY_WERE])
    exact = "\n".join([*ROUNDED.values(), *AS_THEY_WERE])
    assert body in rewrite_for_cuda(kernel(body)).text
    assert exact in rewrite_for_cuda(kernel(body), exact_rounding=True).text


def test_a_register_read_without_mov():
    assert "cvt.u64.u32 %rd1, %nctaid.y;" in rewrite_for_cuda(kernel("cvt.u64.u32 %rd1, %envreg7;")).text


@pytest.mark.parametrize("space", ["shared", "local"])
def test_local_memory_among_the_arguments_is_refused(space):
    with pytest.raises(ValueError, match=r"kernel draw: .*declare it inside the kernel"):
        rewrite_for_cuda(kernel(parameters=f".param .u64 .ptr .{space} .align 4 draw_param_0"))


@pytest.mark.parametrize("parameter", [".param .texref a", ".param .align 8 .b8 a[16]", ".param .u64 .ptr .odd a"])
def test_other_parameters_are_refused(parameter):
    with pytest.raises(ValueError, match="expected a pointer or a number"):
        rewrite_for_cuda(kernel(parameters=parameter))


@pytest.mark.parametrize("binary", [b"", b"\x7fELF\2\1\1\0\0", kernel()[:30] + b"\0" + kernel()[30:]])
def test_what_is_no_text_is_refused(binary):
    with pytest.raises(ValueError, match=r"bytes \([0-9a-f ]*\), expected PTX text"):
        rewrite_for_cuda(binary)


def test_a_program_without_kernels_is_refused():
    with pytest.raises(ValueError, match=r"no \.entry"):
        rewrite_for_cuda(b".version 8.7\n.target sm_90\n")


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_nothing_of_opencl_s_is_left(path):
    text = rewrite_for_cuda(path.read_bytes()).text
    assert not re.search(r"envreg|\.ptr|texmode_independent", text)
    assert len(re.findall(r"\.visible \.entry", text)) == len(re.findall(r"^\.entry", path.read_text(), re.MULTILINE))


@pytest.mark.skipif(shutil.which("ptxas") is None, reason="NVIDIA's assembler is not installed")
@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_nvidia_s_assembler_takes_it(path, tmp_path):
    rewritten = tmp_path / "program.ptx"
    rewritten.write_text(rewrite_for_cuda(path.read_bytes()).text)
    subprocess.run(["ptxas", "-arch=sm_90", "-o", str(tmp_path / "program.cubin"), str(rewritten)], check=True)
