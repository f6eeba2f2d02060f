"""Parallel prefix sums and stable radix sorts for the GPU schedule."""

from __future__ import annotations

import torch
from jaxtyping import Int
from torch import Tensor

from opencl.backend import Session
from opencl.program import GROUP_SIZE, SCAN_CHUNK, SORT_CHUNK, ProgramKey

_DIGIT_BITS = 4
"""Bits of the key per pass, as in sorting.cl."""


def scan(session: Session, program: ProgramKey, values: Int[Tensor, " n"]) -> Int[Tensor, " 1"]:
    """Queue an exclusive prefix sum of `values` (int64) in place. Returns a tensor that will hold the total."""
    chunks = max(1, -(-len(values) // SCAN_CHUNK))
    group_size = GROUP_SIZE[program.schedule]
    totals = session.memory.empty(chunks, dtype=torch.int64)
    session.launch(program, "scan_chunks", chunks, len(values), values, totals, group_size=group_size)
    if chunks == 1:
        return totals
    total = scan(session, program, totals)
    session.launch(program, "add_chunk_starts", chunks, len(values), totals, values, group_size=group_size)
    return total


def sort_by_keys(
    session: Session, program: ProgramKey, bits: int, keys: Int[Tensor, " n"], payloads: Int[Tensor, " n"]
) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"]]:
    """Queue a stable sort by the lowest `bits` bits, rounded up to a multiple of 4, of keys read as unsigned integers.

    Keys have the type of the program's depth keys (int32 for float32, int64 for float64), payloads are int32. Returns
    the sorted keys and payloads. The arguments are overwritten, and may be the tensors returned.
    """
    count, group_size = len(keys), GROUP_SIZE[program.schedule]
    groups = -(-count // SORT_CHUNK)
    memory = session.memory
    other_keys, other_payloads = memory.empty(count, dtype=keys.dtype), memory.empty(count, dtype=payloads.dtype)
    places = memory.empty(groups * 2**_DIGIT_BITS, dtype=torch.int64)
    for shift in range(0, bits, _DIGIT_BITS):
        session.launch(program, "count_digits", groups, count, shift, keys, places, group_size=group_size)
        scan(session, program, places)
        session.launch(
            *(program, "move_by_digit", groups, count, shift),
            *(keys, payloads, places, other_keys, other_payloads),
            group_size=group_size,
        )
        keys, other_keys = other_keys, keys
        payloads, other_payloads = other_payloads, payloads
    return keys, payloads
