"""A network's weights as a safetensors file: it holds only named numbers, so that files from strangers are safe."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from safetensors import SafetensorError
from safetensors.numpy import load, save

from pipeline.errors import UserError

Weights = Mapping[str, Float32[np.ndarray, "..."]]
"""A network's parameters by their names in torch, such as `0.weight`."""

SUFFIX = ".safetensors"
LENGTH_BYTES = 8
LARGEST_HEADER = 2**20  # bytes: thousands of weights; the library itself would accept a hundred million bytes
LARGEST_FILE = 2**30  # bytes; the released code's decoders take half a million
EXPECTED = "the weights of one network, all of type F32"
REMEDY = "Fetch the file again where it came from."


def weights_file(weights: Weights) -> bytes:
    """The content of a safetensors file; the same weights give the same bytes."""
    return save({name: np.asarray(values, order="C") for name, values in weights.items()})


def read_weights(path: Path) -> Weights:
    """Read the weights of one network.

    safetensors checks the header against the file: tensors must be contiguous, without overlap and without a remainder.
    This function also refuses what the library leaves to its caller: headers and files of absurd sizes, types that no
    decoder has, NaN and infinity. Raises `UserError` in all these cases.
    """
    content = _bytes(path)
    header = int.from_bytes(content[:LENGTH_BYTES], "little")
    if len(content) < LENGTH_BYTES or header > min(LARGEST_HEADER, len(content) - LENGTH_BYTES):
        raise UserError(
            "no safetensors file, or one that is cut off",
            where=path,
            found=f"{len(content)} bytes, of which {header} would be the header",
            expected=f"a header within the file, of at most {LARGEST_HEADER} bytes",
            remedy=REMEDY,
        )
    try:
        weights = load(content)
    except (SafetensorError, KeyError, ValueError) as error:  # the last two: types and shapes unknown to NumPy
        raise UserError(
            "a safetensors file that cannot be read",
            where=path,
            found=str(error)[:200],
            expected=EXPECTED,
            remedy=REMEDY,
        ) from error
    for name, values in sorted(weights.items()):
        if values.dtype != np.float32 or not np.isfinite(values).all():
            kind = f"type {values.dtype}" if values.dtype != np.float32 else "NaN or infinity"
            raise UserError(f"the weight {name[:80]!r} is no such", where=path, found=kind, expected=EXPECTED)
    return weights


def _bytes(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise UserError("no such file of weights", where=path, found="a folder" if path.is_dir() else "nothing")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > LARGEST_FILE:
                raise UserError(
                    "a file of weights that is too large",
                    where=path,
                    found=size,
                    expected=f"at most {LARGEST_FILE} bytes",
                )
            return file.read(size)
    except OSError as error:
        raise UserError("cannot be read", where=path, found=error.strerror or error) from error
